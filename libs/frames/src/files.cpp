// SPDX-License-Identifier: Apache-2.0
#include "tempera/frames/files.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <utility>

#include "tempera/core/error.h"

namespace fs = std::filesystem;

namespace tempera {
namespace {
[[noreturn]] void fail(const char* action, const std::string& path, int reason) {
  throw Error(ErrorCode::kFailed, fmt::format("cannot {} {}: {}", action, path, std::strerror(reason)));
}
}  // namespace

TemporaryFile::TemporaryFile(const std::string& path) : final_(path) {
  static std::atomic<unsigned> counter{0};
  std::error_code ec;
  if (fs::is_symlink(path, ec)) {
    const fs::path target = fs::weakly_canonical(path, ec);
    if (!ec) final_ = target.string();
  }
  // Renaming over a device, a pipe or a directory would destroy it (or fail late).
  const fs::file_status status = fs::status(final_, ec);
  if (fs::exists(status) && !fs::is_regular_file(status)) {
    throw Error(ErrorCode::kFailed, fmt::format("cannot write {}: it exists and is not a regular file", path));
  }
  const fs::path p(final_);
  if (p.has_parent_path()) {
    fs::create_directories(p.parent_path(), ec);
    if (ec) fail("create directory", p.parent_path().string(), ec.value());
  }
  for (;;) {
    const std::string name =
        fmt::format(".{}.{}-{}.tmp{}", p.stem().string(), ::getpid(), counter++, p.extension().string());
    temporary_ = (p.parent_path() / name).string();
    fd_ = ::open(temporary_.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
    if (fd_ >= 0) return;
    if (errno != EEXIST) fail("write", path, errno);
  }
}

TemporaryFile::~TemporaryFile() {
  if (fd_ >= 0) ::close(fd_);
  if (!temporary_.empty()) ::unlink(temporary_.c_str());
}

void TemporaryFile::commit() {
  if (!synced_) {  // another program wrote, perhaps a new file of this name
    const int fd = ::open(temporary_.c_str(), O_RDONLY | O_CLOEXEC);
    if (fd < 0) fail("write", final_, errno);
    const int reason = ::fsync(fd) == 0 ? 0 : errno;
    ::close(fd);
    if (reason != 0) fail("write", final_, reason);
  }
  if (::close(std::exchange(fd_, -1)) != 0) fail("write", final_, errno);
  if (::rename(temporary_.c_str(), final_.c_str()) != 0) fail("write", final_, errno);
  temporary_.clear();
  // The rename itself survives a power cut only when the directory is synchronised; not all file systems can.
  const fs::path parent = fs::path(final_).parent_path();
  const int dir = ::open(parent.empty() ? "." : parent.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (dir >= 0) {
    ::fsync(dir);
    ::close(dir);
  }
}

void write_file(const std::string& path, std::span<const std::byte> bytes) {
  TemporaryFile file(path);
  std::size_t done = 0;
  while (done < bytes.size()) {
    const ssize_t n = ::write(file.fd_, bytes.data() + done, std::min<std::size_t>(bytes.size() - done, 1u << 24));
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) fail("write", path, n < 0 ? errno : ENOSPC);
    done += n;
  }
  // Some network file systems report a lost write only here.
  struct stat info {};
  if (::fsync(file.fd_) != 0 || ::fstat(file.fd_, &info) != 0) fail("write", path, errno);
  if (info.st_size != std::ssize(bytes)) fail("write", path, EIO);
  file.synced_ = true;
  file.commit();
}

void write_file(const std::string& path, std::string_view text) {
  write_file(path, std::as_bytes(std::span(text.data(), text.size())));
}

std::string read_file(const std::string& path) {
  const int fd = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (fd < 0) throw Error(ErrorCode::kMissingFile, fmt::format("cannot open {}: {}", path, std::strerror(errno)));
  std::string text;
  char buffer[1 << 16];
  for (;;) {
    const ssize_t n = ::read(fd, buffer, sizeof buffer);
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) {
      const int reason = errno;
      ::close(fd);
      throw Error(ErrorCode::kFailed, fmt::format("cannot read {}: {}", path, std::strerror(reason)));
    }
    if (n == 0) break;
    text.append(buffer, n);
  }
  ::close(fd);
  return text;
}

}  // namespace tempera
