#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Shows that a clone installs, builds and runs on a bare Debian 12: debootstrap makes a root that holds the minimal system
# and git, a clone of this repository is put into it, and COMMAND runs there, as root or as a user with sudo.
#
#   tools/test_install.sh [--as root|user] [--worktree] [--keep] FOLDER [COMMAND]
#
# FOLDER    where the root goes (about 4 GB); the bare system is kept in FOLDER/base for the next run
# COMMAND   what to run in the clone; "./dev setup && ./dev build" unless given
# --as      root (the default), or an ordinary user who may use sudo
# --worktree  take the files of the working tree instead of the last commit
# --keep    leave the root of this run in place, to look at
#
# Needs root and debootstrap. Mirror, suites and network settings are those of this machine's apt configuration.
set -euo pipefail

die() {
  echo "test_install: $*" >&2
  exit 1
}

who=root worktree=0 keep=0
while [[ ${1:-} == -* ]]; do
  case $1 in
    --as)
      who=${2:-}
      [[ $who == root || $who == user ]] || die "--as takes root or user"
      shift
      ;;
    --worktree) worktree=1 ;;
    --keep) keep=1 ;;
    *) die "unknown option $1" ;;
  esac
  shift
done
(($# == 1 || $# == 2)) || die "usage: tools/test_install.sh [--as root|user] [--worktree] [--keep] FOLDER [COMMAND]"
folder=$(realpath -m "$1")
command=${2:-./dev setup && ./dev build}
((EUID == 0)) || die "needs root, for debootstrap and chroot"
command -v debootstrap >/dev/null || die "needs debootstrap (apt-get install debootstrap)"
repository=$(git -C "$(dirname "${BASH_SOURCE[0]}")" rev-parse --show-toplevel)

# The main Debian archives of this machine's apt configuration, e.g. "http://mirror/debian bookworm".
# shellcheck disable=SC2016  # the $(…) are apt-get's
mapfile -t archives < <(apt-get indextargets --format '$(REPO_URI) $(RELEASE)|$(ORIGIN)|$(COMPONENT)' \
  'Created-By: Packages' | awk -F'|' '$2 == "Debian" && $3 == "main" && $1 ~ / bookworm/ {print $1}' | sort -u)
mirror=$(printf '%s\n' "${archives[@]}" | awk '$2 == "bookworm" {print $1; exit}')
[[ -n "$mirror" ]] || die "this machine's apt configuration has no bookworm archive to take the mirror from"

base=$folder/base
root=$folder/$who
mkdir -p "$folder"
if [[ ! -e $base/etc/debian_version ]]; then
  echo "== Bare Debian 12 into $base"
  rm -rf "$base"
  debootstrap --variant=minbase --include=git bookworm "$base" "$mirror" >"$folder/debootstrap.log" 2>&1 ||
    { tail -n 20 "$folder/debootstrap.log" >&2; die "debootstrap failed"; }
fi

mounted=()
cleanup() {
  local target
  for target in "${mounted[@]}"; do umount "$target" || true; done
  mounted=()
  # Never delete through a mount that could not be released.
  if ((!keep)) && ! grep -q " $root/" /proc/mounts; then rm -rf "$root"; fi
}
trap cleanup EXIT

grep -q " $root/" /proc/mounts && die "something is still mounted below $root"
rm -rf "$root"
cp -a "$base" "$root"
mount -t proc proc "$root/proc"
mounted=("$root/proc")
printf 'deb %s main\n' "${archives[@]}" >"$root/etc/apt/sources.list"
# A mirror or a proxy may need what this machine's apt and resolver are told; packages' own apt hooks are not wanted.
apt-config dump | grep '^Acquire::\(Check-\|http\|Retries\)' >"$root/etc/apt/apt.conf.d/90network" || true
cp /etc/resolv.conf /etc/hosts "$root/etc/"

inside() {
  env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin TERM="${TERM:-dumb}" LANG=C.UTF-8 ${http_proxy:+http_proxy="$http_proxy"} \
    ${https_proxy:+https_proxy="$https_proxy"} chroot "$root" "$@"
}

home=/root
if [[ $who == user ]]; then
  inside apt-get -qq update
  inside env DEBIAN_FRONTEND=noninteractive apt-get -qq -y install --no-install-recommends sudo >"$folder/sudo.log" 2>&1 ||
    { cat "$folder/sudo.log" >&2; die "could not install sudo"; }
  rm -rf "$root"/var/lib/apt/lists/*
  inside useradd --create-home --shell /bin/bash artist
  echo 'artist ALL=(ALL) NOPASSWD: ALL' >"$root/etc/sudoers.d/artist"
  chmod 0440 "$root/etc/sudoers.d/artist"
  home=$(inside getent passwd artist | cut -d: -f6)
fi

clone=$root$home/tempera
if ((worktree)); then
  mkdir -p "$clone"
  git -C "$repository" ls-files --cached --others --exclude-standard -z | (cd "$repository" &&
    while IFS= read -r -d '' name; do [[ ! -e $name ]] || printf '%s\0' "$name"; done |
    tar --null --files-from=- -cf -) | tar -xf - -C "$clone"
  git -C "$clone" init -q
else
  git clone -q "file://$repository" "$clone"
fi

echo "== As $who, in a bare Debian $(cat "$root/etc/debian_version"): $command"
begin=$SECONDS
script="cd $home/tempera && $command"
if [[ $who == user ]]; then
  inside chown -R artist:artist "$home"
  inside runuser -l artist -c "$script" </dev/null
else
  inside env HOME=/root bash -c "$script" </dev/null
fi
echo "== Done in $((SECONDS - begin)) s"
