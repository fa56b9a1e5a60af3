// SPDX-License-Identifier: Apache-2.0
#include "tempera/frames/video.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <signal.h>
#include <spawn.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <utility>

#include "tempera/core/log.h"
#include "tempera/frames/files.h"
#include "tempera/frames/frame.h"

extern char** environ;

namespace tempera {
namespace {

/// File descriptor that closes itself.
class Fd {
 public:
  explicit Fd(int fd = -1) : fd_(fd) {}
  ~Fd() { reset(); }
  Fd(const Fd&) = delete;
  Fd& operator=(const Fd&) = delete;
  int get() const { return fd_; }
  void reset(int fd = -1) {
    if (fd_ >= 0) ::close(fd_);
    fd_ = fd;
  }

 private:
  int fd_;
};

struct Container {
  const char* extension;
  const char* muxer;
  std::vector<const char*> codecs;  ///< the first is the default
};
const std::vector<Container>& containers() {
  static const std::vector<Container> list{{".mp4", "mp4", {"h264", "hevc", "av1", "vp9"}},
                                           {".mov", "mov", {"h264", "hevc"}},
                                           {".mkv", "matroska", {"h264", "hevc", "vp9", "av1", "ffv1"}},
                                           {".webm", "webm", {"vp9", "av1"}}};
  return list;
}

/// What ffmpeg is told of the encoder.
std::vector<std::string> encoder_arguments(const std::string& codec, int crf) {
  const std::string quality = std::to_string(crf);
  if (codec == "h264") return {"-c:v", "libx264", "-preset", "medium", "-crf", quality, "-pix_fmt", "yuv420p"};
  if (codec == "hevc") {
    return {"-c:v",     "libx265", "-preset", "medium", "-crf",         quality,
            "-pix_fmt", "yuv420p", "-tag:v",  "hvc1",   "-x265-params", "log-level=error"};
  }
  if (codec == "vp9") {
    return {"-c:v",    "libvpx-vp9", "-b:v",      "0", "-crf",     quality,
            "-row-mt", "1",          "-cpu-used", "2", "-pix_fmt", "yuv420p"};
  }
  if (codec == "av1")
    return {"-c:v",      "libaom-av1", "-b:v",    "0", "-crf",     quality,
            "-cpu-used", "6",          "-row-mt", "1", "-pix_fmt", "yuv420p"};
  return {"-c:v", "ffv1", "-level", "3", "-pix_fmt", "bgr0"};
}

std::string list_of(const std::vector<const char*>& names) { return fmt::format("{}", fmt::join(names, ", ")); }

/// The container of a file name and the codec to use in it.
std::pair<const Container*, std::string> choose(const std::string& path, const std::string& codec) {
  std::string extension = std::filesystem::path(path).extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return char(std::tolower(c)); });
  for (const Container& c : containers()) {
    if (extension != c.extension) continue;
    if (codec == "auto") return {&c, c.codecs[0]};
    for (const char* known : c.codecs) {
      if (codec == known) return {&c, codec};
    }
    throw Error(ErrorCode::kUsage,
                fmt::format("codec \"{}\" does not go into {}; known: auto, {}", codec, extension, list_of(c.codecs)));
  }
  throw Error(ErrorCode::kUsage,
              fmt::format("cannot make a movie \"{}\"; its name must end in .mp4, .mov, .mkv or .webm", path));
}
}  // namespace

struct VideoWriter::Impl {
  std::string path;
  std::string program;
  int width, height;
  DisplayOptions display;
  TemporaryFile file;
  Fd input;   ///< our end of ffmpeg's standard input
  Fd errors;  ///< what ffmpeg says
  pid_t child = -1;
  std::vector<std::uint8_t> padded;

  Impl(const std::string& path_, int w, int h, const VideoOptions& options)
      : path(path_), program(options.ffmpeg), width(w), height(h), display(options.display), file(path_) {}

  ~Impl() {
    if (child < 0) return;
    ::kill(child, SIGKILL);
    input.reset();
    wait();
  }

  int wait() {
    int status = 0;
    while (::waitpid(child, &status, 0) < 0 && errno == EINTR) {
    }
    child = -1;
    return status;
  }

  /// ffmpeg's last words as one line.
  std::string complaint() const {
    std::string text(4096, '\0');
    const ssize_t n = ::pread(errors.get(), text.data(), text.size(), 0);
    text.resize(std::max<ssize_t>(n, 0));
    for (char& c : text) c = c == '\n' ? ' ' : c;
    while (!text.empty() && text.back() == ' ') text.pop_back();
    return text.empty() ? "it gave no reason" : text;
  }

  /// Waits for ffmpeg after it stopped reading and reports what it said.
  [[noreturn]] void fail() {
    input.reset();
    wait();
    throw Error(ErrorCode::kFailed, fmt::format("cannot write {}: {}: {}", path, program, complaint()));
  }
};

void check_video(const std::string& path, const VideoOptions& options) {
  choose(path, options.codec);
  if (!(options.fps >= 0.001) || options.fps > 1000) {
    throw Error(ErrorCode::kOutOfRange,
                fmt::format("a movie cannot have {} frames per second; valid: 0.001 to 1000", options.fps));
  }
  if (options.crf < 0 || options.crf > 51) {
    throw Error(ErrorCode::kOutOfRange,
                fmt::format("quality (crf) {} is out of range; valid: 0 (best) to 51", options.crf));
  }
}

VideoWriter::VideoWriter(const std::string& path, int width, int height, const VideoOptions& options) {
  check_video(path, options);
  const auto [container, codec] = choose(path, options.codec);
  if (width <= 0 || height <= 0)
    throw Error(ErrorCode::kBadInput, fmt::format("cannot write {}: the pictures are empty", path));
  impl_ = std::make_unique<Impl>(path, width, height, options);

  const FrameRate rate = frame_rate(options.fps);
  std::vector<std::string> arguments{options.ffmpeg, "-hide_banner",
                                     "-nostdin",     "-loglevel",
                                     "error",        "-y",
                                     "-f",           "rawvideo",
                                     "-pix_fmt",     "rgb24",
                                     "-video_size",  fmt::format("{}x{}", width + width % 2, height + height % 2),
                                     "-framerate",   fmt::format("{}/{}", rate.numerator, rate.denominator),
                                     "-i",           "pipe:0",
                                     "-an"};
  if (codec != "ffv1") {
    // Players assume the BT.709 matrix, ffmpeg's conversion uses BT.601 unless told.
    arguments.insert(arguments.end(),
                     {"-vf", "scale=out_color_matrix=bt709:out_range=tv:flags=accurate_rnd", "-colorspace", "bt709",
                      "-color_primaries", "bt709", "-color_trc", "iec61966-2-1", "-color_range", "tv"});
  }
  for (std::string& a : encoder_arguments(codec, options.crf)) arguments.push_back(std::move(a));
  if (container->muxer == std::string("mp4") || container->muxer == std::string("mov")) {
    arguments.insert(arguments.end(), {"-movflags", "+faststart"});
  }
  if (!options.comment.empty()) arguments.insert(arguments.end(), {"-metadata", "comment=" + options.comment});
  arguments.insert(arguments.end(), {"-f", container->muxer, "file:" + impl_->file.path()});
  std::vector<char*> argv;
  for (std::string& a : arguments) argv.push_back(a.data());
  argv.push_back(nullptr);

  // A socket as standard input: unlike a pipe it can be written to without a SIGPIPE when ffmpeg dies.
  int ends[2];
  if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends) != 0) {
    throw Error(ErrorCode::kFailed, fmt::format("cannot start {}: {}", options.ffmpeg, std::strerror(errno)));
  }
  impl_->input.reset(ends[0]);
  Fd theirs(ends[1]);
  impl_->errors.reset(::memfd_create("ffmpeg-messages", MFD_CLOEXEC));

  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_adddup2(&actions, theirs.get(), 0);
  posix_spawn_file_actions_addopen(&actions, 1, "/dev/null", O_WRONLY, 0);
  posix_spawn_file_actions_adddup2(&actions, impl_->errors.get(), 2);
  posix_spawnattr_t attributes;
  posix_spawnattr_init(&attributes);
  // A process group of its own: an interrupt from the terminal goes to us, and we decide about the encoder.
  sigset_t none, all;
  sigemptyset(&none);
  sigfillset(&all);
  posix_spawnattr_setsigmask(&attributes, &none);
  posix_spawnattr_setsigdefault(&attributes, &all);
  posix_spawnattr_setpgroup(&attributes, 0);
  posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF | POSIX_SPAWN_SETPGROUP);
  pid_t child = -1;
  const int spawned = ::posix_spawnp(&child, options.ffmpeg.c_str(), &actions, &attributes, argv.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  posix_spawnattr_destroy(&attributes);
  if (spawned != 0) {
    throw Error(ErrorCode::kMissingFile,
                fmt::format("cannot start {} ({}); movies need the Debian package ffmpeg: apt install ffmpeg",
                            options.ffmpeg, std::strerror(spawned)));
  }
  impl_->child = child;
}

VideoWriter::~VideoWriter() = default;
VideoWriter::VideoWriter(VideoWriter&&) noexcept = default;
VideoWriter& VideoWriter::operator=(VideoWriter&&) noexcept = default;

void VideoWriter::add(const Image& image) {
  TEMPERA_ASSERT(impl_);
  Impl& v = *impl_;
  if (image.width() != v.width || image.height() != v.height) {
    throw Error(ErrorCode::kBadInput, fmt::format("cannot write {}: a frame has {}x{} pixels, the first one {}x{}",
                                                  v.path, image.width(), image.height(), v.width, v.height));
  }
  const std::vector<std::uint8_t> pixels = to_rgb8(image, v.display);
  const std::size_t row = 3 * v.width, padded_row = row + (v.width % 2 ? 3 : 0);
  v.padded.clear();
  for (int y = 0; y < v.height + v.height % 2; ++y) {
    const std::uint8_t* from = pixels.data() + row * std::min(y, v.height - 1);
    v.padded.insert(v.padded.end(), from, from + row);
    if (padded_row > row) v.padded.insert(v.padded.end(), from + row - 3, from + row);
  }
  for (std::size_t done = 0; done < v.padded.size();) {
    const ssize_t n = ::send(v.input.get(), v.padded.data() + done, v.padded.size() - done, MSG_NOSIGNAL);
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) v.fail();
    done += n;
  }
}

void VideoWriter::finish() {
  TEMPERA_ASSERT(impl_);
  Impl& v = *impl_;
  v.input.reset();  // end of input: ffmpeg completes the file
  const int status = v.wait();
  // ffmpeg 5 can end with status 0 after a failed write of the last bytes; it says so, and -loglevel error says no
  // more.
  std::string said(1, '\0');
  const bool complained = ::pread(v.errors.get(), said.data(), 1, 0) > 0;
  std::error_code ec;
  if (!WIFEXITED(status) || WEXITSTATUS(status) != 0 || std::filesystem::file_size(v.file.path(), ec) == 0 || ec) {
    throw Error(ErrorCode::kFailed, fmt::format("cannot write {}: {}: {}", v.path, v.program, v.complaint()));
  }
  if (complained) log_warning(fmt::format("{}: {}: {}", v.path, v.program, v.complaint()));
  v.file.commit();
  impl_.reset();
}

bool video_has_comment(const std::string& path, const std::string& comment) {
  TEMPERA_ASSERT(!comment.empty());
  if (std::error_code ignored; !std::filesystem::exists(path, ignored)) return false;
  return read_file(path).find(comment) != std::string::npos;  // containers store it as plain text
}

int write_video(const FrameSequence& frames, const std::string& path, const VideoOptions& options,
                const VideoProgress& progress) {
  if (frames.frames().empty()) throw Error(ErrorCode::kMissingFile, fmt::format("no frames for {}", path));
  check_video(path, options);  // before any frame is read
  const long first = frames.frames().front(), last = frames.frames().back(), step = frames.step();
  const long total = (last - first) / step + 1;
  if (total - long(frames.frames().size()) > 100000) {
    throw Error(ErrorCode::kBadInput, fmt::format("{} holds {} of the frames {} to {}; name a range without such gaps",
                                                  frames.pattern(), frames.frames().size(), first, last));
  }
  ReadOptions read;
  read.layers = {options.layer};
  std::unique_ptr<VideoWriter> writer;
  Image image;
  std::string missing;
  int missing_count = 0;
  for (long i = 0; i < total; ++i) {
    const int frame = int(first + i * step);
    if (frames.has(frame)) {
      Frame f = read_frame(frames.path(frame), read);
      if (writer && (f.width() != image.width() || f.height() != image.height())) {
        throw Error(ErrorCode::kBadInput,
                    fmt::format("{} has {}x{} pixels, the frames before it {}x{}: a movie has one size",
                                frames.path(frame), f.width(), f.height(), image.width(), image.height()));
      }
      image = std::move(f.layer(options.layer));
    } else if (++missing_count <= 10) {
      missing += fmt::format("{}{}", missing.empty() ? "" : ", ", frame);
    }
    if (!writer) writer = std::make_unique<VideoWriter>(path, image.width(), image.height(), options);
    writer->add(image);
    if (progress) progress(int(i + 1), int(total));
  }
  if (missing_count > 0) {
    log_warning(fmt::format("{}: {} missing frame{} repeated from before: {}{}", path, missing_count,
                            missing_count == 1 ? "" : "s", missing, missing_count > 10 ? ", ..." : ""));
  }
  writer->finish();
  return int(total);
}

namespace {
/// Digits and the minus sign as 3x5 dots, one row of three bits after the other.
constexpr std::array<std::uint16_t, 11> kGlyphs{
    0b111101101101111, 0b010110010010111, 0b111001111100111, 0b111001111001111, 0b101101111001001, 0b111100111001111,
    0b111100111101111, 0b111001001001001, 0b111101111101111, 0b111101111001111, 0b000000111000000};

void draw_number(Image& image, int x0, int y0, int number, int scale) {
  const std::string text = std::to_string(number);
  for (int i = 0; i < std::ssize(text); ++i) {
    const std::uint16_t glyph = kGlyphs[text[i] == '-' ? 10 : text[i] - '0'];
    for (int y = 0; y < 5 * scale; ++y) {
      for (int x = 0; x < 3 * scale; ++x) {
        const int px = x0 + i * 4 * scale + x, py = y0 + y;
        if (px >= image.width() || py >= image.height()) continue;
        if (glyph >> (14 - (y / scale * 3 + x / scale)) & 1) image.set_rgb(px, py, Rgb(0.8f));
      }
    }
  }
}
}  // namespace

void write_contact_sheet(const FrameSequence& frames, const std::string& path, const ContactSheetOptions& options) {
  std::vector<int> chosen;
  const auto& all = frames.frames();
  if (all.empty()) throw Error(ErrorCode::kMissingFile, fmt::format("no frames for {}", path));
  const int n = std::min(int(all.size()), std::max(1, options.max_frames));
  for (int i = 0; i < n; ++i) chosen.push_back(all[n == 1 ? 0 : i * (all.size() - 1) / (n - 1)]);

  ReadOptions read;
  read.layers = {options.layer};
  const int w = std::max(16, options.width), gap = 4, label = 14;
  Image sheet;
  int columns = 0, h = 0;
  for (int i = 0; i < n; ++i) {
    Frame f = read_frame(frames.path(chosen[i]), read);
    const Image& picture = f.layer(options.layer);
    if (sheet.empty()) {
      h = std::max(1, int(std::lround(double(picture.height()) * w / picture.width())));
      const double cells = std::sqrt(double(n) * 16 / 9 * (h + label) / w);
      columns = std::clamp(options.columns > 0 ? options.columns : int(std::lround(cells)), 1, n);
      const int rows = (n + columns - 1) / columns;
      sheet = Image(gap + columns * (w + gap), gap + rows * (h + label + gap), 3, 0.1f);
    }
    const int x0 = gap + i % columns * (w + gap), y0 = gap + i / columns * (h + label + gap);
    // Averaged before tone mapping, as a camera further away would see it.
    const Image small = resized(picture, w, h);
    for (int y = 0; y < h; ++y) {
      for (int x = 0; x < w; ++x) sheet.set_rgb(x0 + x, y0 + y, tone_map(small.rgb(x, y), options.display));
    }
    draw_number(sheet, x0, y0 + h + 2, chosen[i], 2);
  }
  write_png(path, sheet, {0, ToneMap::kNone});
}

}  // namespace tempera
