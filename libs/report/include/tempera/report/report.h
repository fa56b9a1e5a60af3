// SPDX-License-Identifier: Apache-2.0
#pragma once
// A comparison as one HTML file that opens from disk without a network: pictures side by side, split and flipped, error
// maps, plots, slices through space and time, and the figures. docs/report.md describes the page and its format.
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "tempera/frames/display.h"
#include "tempera/measure/compare.h"

namespace tempera {

struct ReportOptions {
  std::string title;       ///< empty: made of the labels of the sides
  DisplayOptions display;  ///< that the page begins with; its reader can change it
  /// Size of the stored pictures relative to the frames, in (0, 1]: a report of large frames would not open.
  double scale = 1;
  double picture_bytes = 1.6;  ///< at most, for a pixel of a picture; see EncodeOptions::bytes_per_pixel
  double map_bytes = 0.35;     ///< the same, for a pixel of a map of errors
  /// Up to this size of all pictures together, in bytes, they may take 2.5 times as much: small reports are precise.
  double room = 35e6;
};

/// Writes a report while a comparison of `tests` with `reference` (null: there is none) runs: pass it to
/// compare_sequences as its observer, then call `finish`.
/// Memory:  the pictures and maps of one frame, whatever the length of the sequence: what is finished waits in a
///          temporary file beside the report.
/// Result:  the same bytes for the same files and options, on any number of threads.
/// Errors:  of all members, Error{kFailed} if the file cannot be written; without `finish` nothing stays on the disk.
/// Threads: one at a time.
class ReportWriter final : public CompareObserver {
 public:
  /// `measured` are the options of the comparison: they say which metrics may have maps.
  /// Errors: Error{kOutOfRange} for a scale outside of (0, 1].
  ReportWriter(const std::string& path, const std::vector<CompareInput>& tests, const FrameSequence* reference,
               const CompareOptions& measured, const ReportOptions& options = {});
  ~ReportWriter() override;

  std::vector<std::string> maps() const override;
  bool motion() const override { return true; }
  void reference(int frame, const Image& image, const Image* motion_backward, const Image* motion_forward) override;
  void test(std::size_t side, int frame, const Image& image,
            const std::function<const Image*(std::string_view id)>& map) override;
  /// The vectors of a frame where there is no reference; else they come with it.
  void vectors(int frame, const Image* motion_backward, const Image* motion_forward);

  /// Writes the page. Returns its size in bytes.
  std::int64_t finish(const CompareResult& result);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// Shows sequences that have no reference: passes the frames of each test to `writer` and returns what its `finish`
/// needs. The vectors are those of the first test that has some. Errors: Error{kBadInput} if a test has no frame to
/// show or the sizes differ; those of read_frame.
CompareResult show_sequences(const std::vector<CompareInput>& tests, const CompareOptions& options,
                             ReportWriter& writer, const CompareProgress& progress = {});

}  // namespace tempera
