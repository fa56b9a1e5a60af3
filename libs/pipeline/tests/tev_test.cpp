// SPDX-License-Identifier: Apache-2.0
// The tev display against small servers: one that parses every message, one that never reads, one that hangs up, none
// at all.
#include "tempera/pipeline/tev.h"

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <chrono>
#include <cstring>
#include <map>
#include <mutex>
#include <thread>

#include "tempera/core/log.h"

namespace tempera {
namespace {

using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point t) { return std::chrono::duration<double>(Clock::now() - t).count(); }

/// A listening socket on a free port of this machine.
struct Listener {
  int fd = socket(AF_INET, SOCK_STREAM, 0);
  int port = 0;
  explicit Listener(int wanted_port = 0) {
    const int on = 1;
    setsockopt(fd, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
    sockaddr_in a{};
    a.sin_family = AF_INET;
    a.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    a.sin_port = htons(std::uint16_t(wanted_port));
    socklen_t size = sizeof a;
    EXPECT_EQ(bind(fd, reinterpret_cast<sockaddr*>(&a), size), 0);
    EXPECT_EQ(listen(fd, 4), 0);
    getsockname(fd, reinterpret_cast<sockaddr*>(&a), &size);
    port = ntohs(a.sin_port);
  }
  ~Listener() { close(fd); }
  /// -1 if nobody comes in time.
  int accept_within(double seconds) const {
    pollfd p{fd, POLLIN, 0};
    return poll(&p, 1, int(seconds * 1000)) > 0 ? accept(fd, nullptr, nullptr) : -1;
  }
};

/// The viewer's side: images by name, built from messages; every byte of a message must be used.
class Viewer {
 public:
  struct Picture {
    int width = 0, height = 0, created = 0, updates = 0;
    std::vector<std::string> channels;
    std::vector<float> pixels;  // [height, width, channels]
  };
  std::map<std::string, Picture> pictures;
  std::string problem;

  /// Reads until the peer closes.
  void serve(int fd) {
    std::vector<char> buffer;
    char chunk[65536];
    for (ssize_t n; (n = recv(fd, chunk, sizeof chunk, 0)) > 0;) {
      buffer.insert(buffer.end(), chunk, chunk + n);
      for (;;) {
        std::uint32_t length = 0;
        if (buffer.size() < 4) break;
        std::memcpy(&length, buffer.data(), 4);
        if (length < 5 || length > (1u << 26)) {
          problem = "length " + std::to_string(length);
          return;
        }
        if (buffer.size() < length) break;
        message(buffer.data() + 4, length - 4);
        if (!problem.empty()) return;
        buffer.erase(buffer.begin(), buffer.begin() + length);
      }
    }
    if (!buffer.empty()) problem = "an incomplete message at the end";
  }

 private:
  const char* at_ = nullptr;
  const char* end_ = nullptr;
  template <class T>
  T take() {
    T v{};
    if (end_ - at_ < std::ptrdiff_t(sizeof v)) {
      problem = "a message is too short";
      return v;
    }
    std::memcpy(&v, at_, sizeof v);
    at_ += sizeof v;
    return v;
  }
  std::string take_text() {
    const auto* zero = static_cast<const char*>(std::memchr(at_, 0, std::size_t(end_ - at_)));
    if (!zero) {
      problem = "a string without end";
      return {};
    }
    std::string s(at_, zero);
    at_ = zero + 1;
    return s;
  }

  void message(const char* begin, std::size_t size) {
    at_ = begin;
    end_ = begin + size;
    const auto kind = take<std::uint8_t>();
    take<std::uint8_t>();  // grab focus
    const std::string name = take_text();
    if (kind == 4) {
      Picture p;
      p.created = pictures[name].created + 1;
      p.width = take<std::int32_t>();
      p.height = take<std::int32_t>();
      const int n = take<std::int32_t>();
      for (int i = 0; i < n && problem.empty(); ++i) p.channels.push_back(take_text());
      p.pixels.assign(std::size_t(p.width) * std::size_t(p.height) * std::size_t(n), -1.0f);
      pictures[name] = p;
    } else if (kind == 6) {
      if (!pictures.contains(name)) {
        problem = "an update of an image that was not created";
        return;
      }
      Picture& p = pictures[name];
      const auto n = std::size_t(take<std::int32_t>());
      std::vector<std::string> channels;
      for (std::size_t i = 0; i < n && problem.empty(); ++i) channels.push_back(take_text());
      if (channels != p.channels) problem = "other channels than at creation";
      const int x = take<std::int32_t>(), y = take<std::int32_t>(), w = take<std::int32_t>(), h = take<std::int32_t>();
      if (x < 0 || y < 0 || w < 1 || h < 1 || x + w > p.width || y + h > p.height)
        problem = "a tile outside of the image";
      std::vector<std::int64_t> offset, stride;
      for (std::size_t i = 0; i < n; ++i) offset.push_back(take<std::int64_t>());
      for (std::size_t i = 0; i < n; ++i) stride.push_back(take<std::int64_t>());
      if (!problem.empty()) return;
      std::vector<float> data(std::size_t(end_ - at_) / sizeof(float));
      std::memcpy(data.data(), at_, data.size() * sizeof(float));
      at_ += data.size() * sizeof(float);
      for (std::size_t c = 0; c < n; ++c) {
        for (int i = 0; i < w * h; ++i) {
          const std::int64_t k = offset[c] + i * stride[c];
          if (k < 0 || k >= std::int64_t(data.size())) {
            problem = "data too short for its strides";
            return;
          }
          p.pixels[(std::size_t(y + i / w) * std::size_t(p.width) + std::size_t(x + i % w)) * n + c] = data[k];
        }
      }
      ++p.updates;
    } else {
      problem = "message kind " + std::to_string(kind);
    }
    if (problem.empty() && at_ != end_) problem = "bytes left over";
  }
};

/// A frame whose pixels tell where they are, and its tiles.
struct Picture {
  Frame frame;
  std::vector<Tile> tiles;
  Picture(int width, int height) : frame(width, height) {
    Image& color = frame.create(layers::color());
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        for (int c = 0; c < 4; ++c) color.at(x, y, c) = float(x + 1000 * y) + 0.25f * float(c);
      }
    }
    for (int y = 0; y < height; y += 32) {
      for (int x = 0; x < width; x += 32) tiles.push_back({x, y, std::min(x + 32, width), std::min(y + 32, height)});
    }
  }
  void render_to(RenderObserver& o) const {
    o.frame_begin(1, frame, 0);
    for (const Tile& t : tiles) o.tile_done(1, frame, t, {});
  }
};

void expect_same(const Viewer::Picture& shown, const Picture& p) {
  ASSERT_EQ(shown.width, p.frame.width());
  ASSERT_EQ(shown.height, p.frame.height());
  EXPECT_EQ(shown.channels, (std::vector<std::string>{"R", "G", "B", "A"}));
  const auto values = p.frame.layer("color").values();
  EXPECT_TRUE(std::equal(values.begin(), values.end(), shown.pixels.begin(), shown.pixels.end()));
}

const TevOptions kFast{0.005, 1.0, 0.02};

TEST(Tev, ReadsAddresses) {
  EXPECT_EQ(parse_tev_address("").port, 14158);
  EXPECT_EQ(parse_tev_address("render7").host, "render7");
  EXPECT_EQ(parse_tev_address(":9000").port, 9000);
  EXPECT_EQ(parse_tev_address(":9000").host, "127.0.0.1");
  EXPECT_EQ(parse_tev_address("[::1]:9000").host, "::1");
  EXPECT_EQ(parse_tev_address("[::1]:9000").port, 9000);
  for (const char* bad : {"host:", "host:x", "host:0", "host:70000", "[::1"})
    EXPECT_THROW(parse_tev_address(bad), Error) << bad;
}

TEST(Tev, ViewerGetsEveryPixelOfTheLastFrame) {
  const Listener listener;
  Viewer viewer;
  std::thread server([&] {
    const int fd = listener.accept_within(5);
    ASSERT_GE(fd, 0);
    viewer.serve(fd);
    close(fd);
  });
  const Picture first(100, 70), second(40, 90);  // another size: another image under the same name
  {
    const auto display = make_tev_display({"127.0.0.1", listener.port}, "shot", kFast);
    first.render_to(*display);
    std::this_thread::sleep_for(std::chrono::milliseconds(60));
    second.render_to(*display);
  }
  server.join();
  EXPECT_EQ(viewer.problem, "");
  ASSERT_EQ(viewer.pictures.size(), 1u);
  expect_same(viewer.pictures.at("shot"), second);
}

TEST(Tev, ViewerThatComesLateGetsTheWholePicture) {
  int port = 0;
  { port = Listener().port; }
  Viewer viewer;
  const Picture p(64, 64);
  std::thread server;
  testing::internal::CaptureStderr();
  {
    const auto display = make_tev_display({"127.0.0.1", port}, "shot", kFast);
    p.render_to(*display);
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
    server = std::thread([&] {
      const Listener listener(port);
      const int fd = listener.accept_within(5);
      ASSERT_GE(fd, 0);
      viewer.serve(fd);
      close(fd);
    });
    std::this_thread::sleep_for(std::chrono::milliseconds(300));
  }
  server.join();
  const std::string log = testing::internal::GetCapturedStderr();
  EXPECT_EQ(viewer.problem, "");
  expect_same(viewer.pictures.at("shot"), p);
  EXPECT_EQ(std::count(log.begin(), log.end(), '\n'), 1) << log;
}

TEST(Tev, ViewerThatNeverReadsDelaysNothing) {
  const Listener listener;
  std::thread server([&] {
    const int fd = listener.accept_within(5);
    std::this_thread::sleep_for(std::chrono::milliseconds(1500));
    close(fd);
  });
  const Picture large(2048, 1024);  // more than socket buffers hold
  const auto begin = Clock::now();
  TevOptions options = kFast;
  options.flush_seconds = 0.3;
  auto display = make_tev_display({"127.0.0.1", listener.port}, "shot", options);
  double slowest = 0;
  for (int frame = 0; frame < 3; ++frame) {
    display->frame_begin(frame, large.frame, 0);
    for (const Tile& t : large.tiles) {
      const auto call = Clock::now();
      display->tile_done(frame, large.frame, t, {});
      slowest = std::max(slowest, seconds_since(call));
    }
  }
  EXPECT_LT(slowest, 0.25) << "a tile waited for the viewer";
  display.reset();
  EXPECT_LT(seconds_since(begin), 2.5);
  server.join();
}

TEST(Tev, ViewerThatHangsUpIsWarnedAboutOnce) {
  const Listener listener;
  std::thread server([&] {
    for (int i = 0; i < 3; ++i) {
      const int fd = listener.accept_within(1);
      if (fd >= 0) close(fd);
    }
  });
  const Picture p(256, 256);
  testing::internal::CaptureStderr();
  {
    const auto display = make_tev_display({"127.0.0.1", listener.port}, "shot", kFast);
    for (int i = 0; i < 20; ++i) {
      p.render_to(*display);
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
  }
  const std::string log = testing::internal::GetCapturedStderr();
  EXPECT_EQ(std::count(log.begin(), log.end(), '\n'), 1) << log;
  EXPECT_EQ(log.find("rror"), std::string::npos) << log;
  server.join();
}

TEST(Tev, NoViewerIsOneWarning) {
  int port = 0;
  { port = Listener().port; }
  const Picture p(64, 64);
  testing::internal::CaptureStderr();
  const auto begin = Clock::now();
  {
    const auto display = make_tev_display({"127.0.0.1", port}, "shot", kFast);
    for (int i = 0; i < 10; ++i) {
      p.render_to(*display);
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
    }
  }
  EXPECT_LT(seconds_since(begin), 2.0);
  const std::string log = testing::internal::GetCapturedStderr();
  EXPECT_EQ(std::count(log.begin(), log.end(), '\n'), 1) << log;
  EXPECT_NE(log.find("no answer from tev"), std::string::npos) << log;
}

}  // namespace
}  // namespace tempera
