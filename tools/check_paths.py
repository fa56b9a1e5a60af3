#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Checks that no file of the repository names a place of the machine that it was written on.

Looks for absolute paths into a home, work, mount or temporary folder: a clone elsewhere does not have them.
Exit status: 0 none found, 1 otherwise; each fault is printed as file:line.
"""
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PLACES = ("work", "root", "home", "mnt", "tmp", "Users")
# Not preceded by what would make it part of a relative path, of a URL or of a pattern.
PATTERN = re.compile(r"(?<![\w.)}\]$/*-])/(?:" + "|".join(PLACES) + r")/\w")


def main() -> int:
    listing = subprocess.run(["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"], cwd=ROOT,
                             capture_output=True, check=True).stdout.decode()
    faults = 0
    for name in filter(None, listing.split("\0")):
        path = ROOT / name
        if not path.is_file():
            continue
        data = path.read_bytes()
        if b"\0" in data[:8192]:
            continue  # pictures and other binary files
        for number, line in enumerate(data.decode("utf-8", errors="replace").splitlines(), 1):
            if match := PATTERN.search(line):
                print(f"{name}:{number}: a path of one machine: {line[match.start():match.start() + 60].strip()}",
                      file=sys.stderr)
                faults += 1
    print(f"paths: {faults} faults")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
