// SPDX-License-Identifier: Apache-2.0
#include "tempera/pipeline/tev.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <bit>
#include <charconv>
#include <chrono>
#include <condition_variable>
#include <cstring>
#include <deque>
#include <mutex>
#include <thread>
#include <vector>

#include "tempera/core/grid.h"
#include "tempera/core/log.h"

namespace tempera {

static_assert(std::endian::native == std::endian::little, "tev's messages are written as they are in memory");

TevAddress parse_tev_address(std::string_view text) {
  TevAddress a;
  std::string_view port;
  const auto colon = text.rfind(':');
  if (text.starts_with('[')) {  // IPv6 address in brackets
    const auto close = text.find(']');
    if (close == std::string_view::npos)
      throw Error(ErrorCode::kUsage, fmt::format("cannot read the address \"{}\"", text));
    a.host = text.substr(1, close - 1);
    if (close + 1 < text.size()) port = text.substr(close + 2);
  } else if (colon != std::string_view::npos) {
    if (colon > 0) a.host = text.substr(0, colon);
    port = text.substr(colon + 1);
    if (port.empty()) port = "?";
  } else if (!text.empty()) {
    a.host = text;
  }
  if (!port.empty()) {
    const auto [end, ec] = std::from_chars(port.data(), port.data() + port.size(), a.port);
    if (ec != std::errc() || end != port.data() + port.size() || a.port < 1 || a.port > 65535) {
      throw Error(ErrorCode::kUsage,
                  fmt::format("cannot read the address \"{}\"; write for example 127.0.0.1:{}", text, kTevPort));
    }
  }
  return a;
}

namespace {

using Clock = std::chrono::steady_clock;

Clock::duration seconds(double s) {
  return std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(s));
}

/// One message under construction.
class Message {
 public:
  enum Kind : std::uint8_t { kCreateImage = 4, kUpdateImageV3 = 6 };
  explicit Message(Kind kind) : bytes_(4) { value(std::uint8_t(kind)); }
  template <class T>
  void value(const T& v) {
    const auto* p = reinterpret_cast<const char*>(&v);
    bytes_.insert(bytes_.end(), p, p + sizeof v);
  }
  void text(const std::string& s) { bytes_.insert(bytes_.end(), s.c_str(), s.c_str() + s.size() + 1); }
  std::vector<char> finish() && {
    const auto n = std::uint32_t(bytes_.size());
    std::memcpy(bytes_.data(), &n, sizeof n);
    return std::move(bytes_);
  }

 private:
  std::vector<char> bytes_;
};

constexpr int kChannels = 4;
const char* const kChannelNames[kChannels] = {"R", "G", "B", "A"};

/// What the renderer writes and the sending thread reads. Shared, because a thread that is stuck in a name look-up is
/// left behind when the render ends.
struct Shared {
  std::mutex mutex;
  std::condition_variable changed;
  bool stop = false;          // no more tiles will come; leave when all are sent
  bool finished = false;      // the thread has left
  std::uint64_t picture = 0;  // counts changes of size: each needs a new image in the viewer
  Grid<std::array<float, kChannels>> pixels;
  std::deque<Tile> dirty;  // tiles that the viewer lacks
};

/// A TCP connection whose calls give up when asked to.
class Connection {
 public:
  explicit Connection(int fd = -1) : fd_(fd) {}
  Connection(Connection&& o) noexcept : fd_(std::exchange(o.fd_, -1)) {}
  Connection& operator=(Connection&& o) noexcept {
    std::swap(fd_, o.fd_);
    return *this;
  }
  ~Connection() {
    if (fd_ >= 0) close(fd_);
  }
  explicit operator bool() const { return fd_ >= 0; }

  /// Not connected if no viewer answers before `give_up()` or two seconds.
  template <class F>
  static Connection open(const TevAddress& address, F&& give_up) {
    addrinfo hints{}, *list = nullptr;
    hints.ai_socktype = SOCK_STREAM;
    if (getaddrinfo(address.host.c_str(), std::to_string(address.port).c_str(), &hints, &list) != 0)
      return Connection();
    Connection out;
    for (const addrinfo* a = list; a && !out; a = a->ai_next) {
      Connection c(socket(a->ai_family, a->ai_socktype | SOCK_NONBLOCK | SOCK_CLOEXEC, a->ai_protocol));
      if (!c) continue;
      if (connect(c.fd_, a->ai_addr, a->ai_addrlen) != 0) {
        if (errno != EINPROGRESS) continue;
        const auto deadline = Clock::now() + seconds(2);
        int error = ETIMEDOUT;
        socklen_t size = sizeof error;
        while (Clock::now() < deadline && !give_up()) {
          if (c.wait(POLLOUT)) {
            getsockopt(c.fd_, SOL_SOCKET, SO_ERROR, &error, &size);
            break;
          }
        }
        if (error != 0) continue;
      }
      const int on = 1;
      setsockopt(c.fd_, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
      out = std::move(c);
    }
    freeaddrinfo(list);
    return out;
  }

  /// False if the peer is gone or `give_up()`.
  template <class F>
  bool send(const std::vector<char>& bytes, F&& give_up) {
    std::size_t at = 0;
    while (at < bytes.size()) {
      const ssize_t n = ::send(fd_, bytes.data() + at, bytes.size() - at, MSG_NOSIGNAL);
      if (n > 0) {
        at += n;
      } else if (n < 0 && errno != EAGAIN && errno != EWOULDBLOCK && errno != EINTR) {
        return false;
      } else if (!wait(POLLOUT) && give_up()) {
        return false;
      }
    }
    return true;
  }

  /// Whether the peer has closed. What it says is read and dropped, as tev says nothing.
  bool closed() {
    char buffer[256];
    for (;;) {
      const ssize_t n = recv(fd_, buffer, sizeof buffer, MSG_DONTWAIT);
      if (n == 0) return true;
      if (n < 0) return errno != EAGAIN && errno != EWOULDBLOCK && errno != EINTR;
    }
  }

 private:
  /// Waits a little for the socket to become ready.
  bool wait(short events) const {
    pollfd p{fd_, events, 0};
    return poll(&p, 1, 50) > 0;
  }
  int fd_;
};

class Sender {
 public:
  Sender(std::shared_ptr<Shared> shared, TevAddress address, std::string name, TevOptions options)
      : shared_(std::move(shared)), address_(std::move(address)), name_(std::move(name)), options_(options) {}

  void run() {
    Connection connection;
    std::uint64_t shown = 0;  // picture that the viewer has
    Clock::time_point next_try{};
    for (;;) {
      std::vector<Tile> tiles;
      bool created = true;
      int width = 0, height = 0;
      std::uint64_t picture = 0;
      {
        std::unique_lock lock(shared_->mutex);
        // A timed wait while there is nothing to send, too: it finds out that the viewer was closed.
        shared_->changed.wait_for(lock, seconds(options_.interval), [&] { return shared_->stop; });
        if (shared_->stop && shared_->dirty.empty()) break;
        lock.unlock();
        if (expired()) break;
        lock.lock();
        if (shared_->dirty.empty() && !connection) continue;
        created = shown == shared_->picture;
        picture = shared_->picture;
        width = shared_->pixels.width(), height = shared_->pixels.height();
      }
      if (connection && connection.closed()) lost(connection, shown);
      if (!connection) {
        if (Clock::now() < next_try) {
          if (stopping()) break;
          continue;
        }
        next_try = Clock::now() + seconds(options_.retry_seconds);
        connection = Connection::open(address_, [&] { return stopping(); });
        if (!connection) {
          warn("no answer from");
          if (stopping()) break;
          continue;
        }
        created = false;
      }
      if (!created) {
        if (!connection.send(create_message(width, height), [&] { return expired(); })) {
          lost(connection, shown);
          continue;
        }
        shown = picture;
        everything_is_dirty();
      }
      send_tiles(connection, shown);
      if (expired()) break;
    }
    const std::scoped_lock lock(shared_->mutex);
    shared_->finished = true;
    shared_->changed.notify_all();
  }

 private:
  bool stopping() {
    const std::scoped_lock lock(shared_->mutex);
    return shared_->stop;
  }
  /// Whether the render has ended and waited long enough.
  bool expired() {
    if (!stopping()) return false;
    if (stop_seen_ == Clock::time_point{}) stop_seen_ = Clock::now();
    return Clock::now() > stop_seen_ + seconds(options_.flush_seconds);
  }
  void warn(const char* what) {
    if (warned_) return;
    warned_ = true;
    log_warning(fmt::format("{} tev at {}:{}; rendering goes on, and the picture is shown when it comes back", what,
                            address_.host, address_.port));
  }
  void lost(Connection& connection, std::uint64_t& shown) {
    warn("lost");
    connection = Connection();
    shown = 0;
  }

  std::vector<char> create_message(int width, int height) const {
    Message m(Message::kCreateImage);
    m.value(std::uint8_t(1));
    m.text(name_);
    m.value(std::int32_t(width));
    m.value(std::int32_t(height));
    m.value(std::int32_t(kChannels));
    for (const char* c : kChannelNames) m.text(c);
    return std::move(m).finish();
  }

  /// A viewer that comes anew lacks all tiles, also those that were sent to its predecessor.
  void everything_is_dirty() {
    const std::scoped_lock lock(shared_->mutex);
    shared_->dirty.clear();
    constexpr int kSide = 128;
    const int width = shared_->pixels.width(), height = shared_->pixels.height();
    for (int y = 0; y < height; y += kSide) {
      for (int x = 0; x < width; x += kSide) {
        shared_->dirty.push_back({x, y, std::min(x + kSide, width), std::min(y + kSide, height)});
      }
    }
  }

  void send_tiles(Connection& connection, std::uint64_t& shown) {
    for (;;) {
      std::vector<char> bytes;
      {
        const std::scoped_lock lock(shared_->mutex);
        if (shared_->dirty.empty() || shared_->picture != shown) return;
        const Tile t = shared_->dirty.front();
        shared_->dirty.pop_front();
        bytes = tile_message(t);
      }
      if (!connection.send(bytes, [&] { return expired(); })) return lost(connection, shown);
    }
  }

  /// Pre: the mutex is held.
  std::vector<char> tile_message(const Tile& t) const {
    Message m(Message::kUpdateImageV3);
    m.value(std::uint8_t(0));
    m.text(name_);
    m.value(std::int32_t(kChannels));
    for (const char* c : kChannelNames) m.text(c);
    for (const int v : {t.x0, t.y0, t.x1 - t.x0, t.y1 - t.y0}) m.value(std::int32_t(v));
    for (int c = 0; c < kChannels; ++c) m.value(std::int64_t(c));
    for (int c = 0; c < kChannels; ++c) m.value(std::int64_t(kChannels));
    for (int y = t.y0; y < t.y1; ++y) {
      for (int x = t.x0; x < t.x1; ++x) {
        for (const float v : shared_->pixels.at(x, y)) m.value(v);
      }
    }
    return std::move(m).finish();
  }

  std::shared_ptr<Shared> shared_;
  TevAddress address_;
  std::string name_;
  TevOptions options_;
  bool warned_ = false;
  Clock::time_point stop_seen_{};
};

class TevDisplay final : public RenderObserver {
 public:
  TevDisplay(const TevAddress& address, const std::string& name, const TevOptions& options)
      : options_(options),
        thread_([shared = shared_, address, name, options] { Sender(shared, address, name, options).run(); }) {}

  ~TevDisplay() override {
    std::unique_lock lock(shared_->mutex);
    shared_->stop = true;
    shared_->changed.notify_all();
    const bool left =
        shared_->changed.wait_for(lock, seconds(options_.flush_seconds + 1), [&] { return shared_->finished; });
    lock.unlock();
    // It can only be stuck in a name look-up, which cannot be cancelled; it touches nothing but `shared_`.
    left ? thread_.join() : thread_.detach();
  }

  void frame_begin(int, const Frame& picture, std::size_t tiles_done) override {
    const std::scoped_lock lock(shared_->mutex);
    if (picture.width() != shared_->pixels.width() || picture.height() != shared_->pixels.height()) {
      ++shared_->picture;
      shared_->dirty.clear();
      shared_->pixels.assign(picture.width(), picture.height());
    }
    if (tiles_done > 0) copy(picture, {0, 0, picture.width(), picture.height()});
  }
  void tile_done(int, const Frame& picture, const Tile& tile, const RenderTotals&) override {
    if (tile.x0 == tile.x1) return;  // light paths have no place of their own
    const std::scoped_lock lock(shared_->mutex);
    copy(picture, tile);
  }

 private:
  /// Pre: the mutex is held.
  void copy(const Frame& picture, const Tile& tile) {
    const Image& color = picture.layer("color");
    const int channels = color.channels();
    for (int y = tile.y0; y < tile.y1; ++y) {
      for (int x = tile.x0; x < tile.x1; ++x) {
        const float* in = color.pixel(x, y);
        std::array<float, kChannels>& out = shared_->pixels.at(x, y);
        for (int c = 0; c < kChannels; ++c) out[c] = c < channels ? in[c] : 1.0f;
      }
    }
    // A slow viewer gets the newest pixels of a tile once, however often it changed.
    const auto same = [&](const Tile& t) {
      return t.x0 <= tile.x0 && t.y0 <= tile.y0 && t.x1 >= tile.x1 && t.y1 >= tile.y1;
    };
    if (std::none_of(shared_->dirty.begin(), shared_->dirty.end(), same)) shared_->dirty.push_back(tile);
  }

  TevOptions options_;
  std::shared_ptr<Shared> shared_ = std::make_shared<Shared>();
  std::thread thread_;  // last: it uses the above
};

}  // namespace

std::unique_ptr<RenderObserver> make_tev_display(const TevAddress& address, const std::string& name,
                                                 const TevOptions& options) {
  return std::make_unique<TevDisplay>(address, name, options);
}

}  // namespace tempera
