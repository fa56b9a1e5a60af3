// SPDX-License-Identifier: Apache-2.0
#pragma once
// A section in progress: its pictures, and which units of which passes they hold. It can be stored and continued at any
// time, and parts of one section that different machines rendered add up to the whole.
#include <array>
#include <cstdint>
#include <memory>
#include <mutex>
#include <shared_mutex>
#include <span>
#include <string>
#include <vector>

#include "tempera/methods/method.h"
#include "tempera/transport/splat_film.h"

namespace tempera {

/// Side of the square tiles in pixels. A constant, so that checkpoints fit any later run.
inline constexpr int kTileSize = 32;

/// Tiles that cover [0,width) x [0,height), row by row.
std::vector<Tile> make_tiles(int width, int height, int size = kTileSize);

/// Sums over units or frames.
struct RenderTotals {
  std::uint64_t samples = 0, rays = 0, shadow_rays = 0, bad_samples = 0;
  std::vector<BadSample> first_bad;  ///< at most 16
  RenderTotals() = default;
  explicit RenderTotals(const RenderCounters& counters)
      : samples(counters.samples),
        rays(counters.rays),
        shadow_rays(counters.shadow_rays),
        bad_samples(counters.bad_samples),
        first_bad(counters.first_bad) {}
  RenderTotals& operator+=(const RenderTotals& o);
};

/// Which units of each pass a machine renders: those whose number leaves the rest `index` after division by `count`.
struct Part {
  int index = 0, count = 1;
  bool has(std::int64_t number) const { return number % count == index; }
  bool operator==(const Part&) const = default;
};

/// Threads: `commit` from many, `save` beside it; the rest from one.
class Section {
 public:
  /// `frames`: of the section, for which pictures are wanted, ascending. `passes`: all of the method, or the first
  /// ones.
  Section(const Method& method, const RenderSettings& settings, const Scene& scene, FrameRange range,
          std::vector<int> frames, std::vector<PassDesc> passes, int tile_size = kTileSize);

  FrameRange range() const { return range_; }
  const std::vector<int>& frames() const { return frames_; }
  const std::vector<PassDesc>& passes() const { return passes_; }
  const std::vector<Tile>& tiles() const { return tiles_; }
  Frame& picture(int frame);

  std::int64_t units(int pass) const { return std::int64_t(done_[pass].size()); }
  std::int64_t units() const;
  std::int64_t units_done() const;
  bool is_done(int pass, std::int64_t number) const { return done_[pass][number] != 0; }
  bool is_done(int pass) const;
  bool is_done() const { return units_done() == units(); }
  /// Unit `number` of a pass, as Method::run takes it. Tiles are numbered frame by frame.
  Unit unit(int pass, std::int64_t number) const;
  std::shared_ptr<const Bytes> kept(const Unit& unit) const;
  /// For Method::end_pass.
  PassResult result(int pass);

  /// Marks a unit as done, with what it splats and keeps.
  void commit(const Unit& unit, std::span<const UnitOutput::Splat> splats, Bytes kept, const RenderTotals& totals);
  /// How many passes have ended, and what they left in the SectionState.
  int ended() const { return ended_; }
  const Bytes& state() const { return state_; }
  void end_passes(int ended, Bytes state);

  /// Adds up what was splatted, lets the method finish the pictures, and removes its work layers. Pre: is_done().
  void finish(const Method& method);
  /// Values that a layer's declared range had no place for.
  std::uint64_t lost() const;
  RenderTotals totals() const;

  /// All of the above, in the state between two commits.
  void save(ByteWriter& out) const;
  /// What was saved, to be merged and finished; continuing it takes `load`. Errors: Error{kBadInput} for damaged bytes.
  static std::unique_ptr<Section> read(ByteReader& in);
  /// Takes over what was saved of this section. Errors: Error{kBadInput} for another one's, or damaged bytes; this is
  /// then as it was.
  void load(ByteReader& in);
  /// Takes over the units of another part. Errors: Error{kBadInput} for units that are in both, or for another section.
  void merge(const Section& other);
  /// The units that no part has so far, for people: `3 of 12 units of the pass "light"`; empty if there are none.
  std::string missing() const;

 private:
  using Kept = std::vector<std::shared_ptr<const Bytes>>;
  Section() = default;
  void make_splats();
  struct SplatTarget {
    int pass = 0;
    SplatLayer layer;
    std::unique_ptr<SplatFilm> film;
  };
  std::string layout() const;
  std::size_t slot(const Unit& unit) const;
  Kept& kept_of(int pass) { return kept_[std::size_t(passes_[pass].domain)]; }
  std::size_t frame_index(int frame) const;
  /// Whether a pass has written the tile: then it counts, in the files, too.
  bool has_pixels(const std::vector<std::vector<char>>& done, std::size_t frame, std::size_t tile) const;

  FrameRange range_;
  std::vector<int> frames_;
  std::vector<PassDesc> passes_;
  std::vector<LayerDesc> work_layers_;
  int width_ = 0, height_ = 0, tile_size_ = kTileSize;
  std::vector<Tile> tiles_;
  Vec2i origin_;
  std::vector<std::unique_ptr<Frame>> pictures_;
  std::vector<Frame*> all_pictures_;
  std::vector<SplatTarget> splats_;

  mutable std::mutex mutex_;              // of what follows
  mutable std::shared_mutex film_mutex_;  // shared by units that splat; exclusive: between two of them
  std::vector<std::vector<char>> done_;   // by pass and unit
  std::array<Kept, 2> kept_;              // by domain: by tile of all frames; by unit of the pass of paths that runs
  int ended_ = 0;
  Bytes state_;
  RenderTotals totals_;
};

}  // namespace tempera
