// SPDX-License-Identifier: Apache-2.0
#include "tempera/methods/render_section.h"

#include <algorithm>
#include <atomic>
#include <cmath>

#include "tempera/core/parallel.h"

namespace tempera {

namespace {

using Domain = PassDesc::Domain;

/// Numbers of tiles from the center outwards, ring by ring, as there the subject is. Results do not depend on it.
std::vector<std::int64_t> tile_order(const std::vector<Tile>& tiles) {
  const int width = tiles.empty() ? 0 : tiles.back().x1, height = tiles.empty() ? 0 : tiles.back().y1;
  const double size = tiles.empty() ? 1 : std::max(1, tiles[0].x1 - tiles[0].x0);
  std::vector<std::int64_t> order(tiles.size());
  for (std::size_t i = 0; i < order.size(); ++i) order[i] = std::int64_t(i);
  const auto key = [&](std::int64_t i) {
    const Tile& t = tiles[i];
    const double x = 0.5 * (t.x0 + t.x1 - width) / size, y = 0.5 * (t.y0 + t.y1 - height) / size;
    return std::pair(std::lround(std::max(std::abs(x), std::abs(y))), std::atan2(y, x));
  };
  std::stable_sort(order.begin(), order.end(), [&](std::int64_t a, std::int64_t b) { return key(a) < key(b); });
  return order;
}

/// The units of passes [first, last) that are missing, in the order in which they are begun: tiles of a frame with all
/// their passes, then light paths.
std::vector<Unit> missing_units(const Section& section, int first, int last, const Part& part) {
  std::vector<Unit> result;
  const auto add = [&](int pass, std::int64_t number) {
    if (part.has(number) && !section.is_done(pass, number)) result.push_back(section.unit(pass, number));
  };
  const std::vector<std::int64_t> order = tile_order(section.tiles());
  const auto tiles = std::int64_t(order.size());
  for (std::int64_t f = 0; f < std::int64_t(section.frames().size()); ++f) {
    for (const std::int64_t t : order) {
      for (int p = first; p < last; ++p) {
        if (section.passes()[p].domain == Domain::kTiles) add(p, f * tiles + t);
      }
    }
  }
  for (int p = first; p < last; ++p) {
    if (section.passes()[p].domain != Domain::kPaths) continue;
    for (std::int64_t i = 0; i < section.units(p); ++i) add(p, i);
  }
  return result;
}

}  // namespace

class SectionRender {
 public:
  SectionRender(const Method& method, SceneWindow& window, Section& section, const Part& part,
                const SectionHooks& hooks, const std::stop_token& stop)
      : method_(method), window_(window), section_(section), part_(part), hooks_(hooks), stop_(stop) {}

  bool run() {
    const auto count = int(section_.passes().size());
    FrameReach reach;
    for (const PassDesc& p : section_.passes()) {
      reach.before = std::max(reach.before, p.scene.before);
      reach.after = std::max(reach.after, p.scene.after);
    }
    window_.set_reach(reach);
    state_ = method_.begin(window_);
    if (section_.ended() > 0 && state_) {
      ByteReader in(section_.state());
      state_->load(in);
    }
    for (int first = section_.ended(); first < count;) {
      int last = first + 1;
      while (last < count && !section_.passes()[last].waits) ++last;
      if (!run_passes(first, last)) return false;
      if (last < count) {
        bool all = true;
        for (int p = first; p < last; ++p) all &= section_.is_done(p);
        if (!all) return true;  // the rest waits for other parts
        end_passes(first, last);
      }
      first = last;
    }
    return true;
  }

 private:
  /// Returns whether all units of the part are done.
  bool run_passes(int first, int last) {
    const std::vector<Unit> units = missing_units(section_, first, last, part_);
    if (units.empty()) return !stop_.stop_requested();
    for (int p = first; p < last; ++p) {
      const PassDesc& pass = section_.passes()[p];
      if (pass.domain == Domain::kPaths) {
        for (int f = section_.range().first; f <= section_.range().last; ++f) window_.frame(f);
      } else {
        for (const int f : section_.frames()) {
          const auto wants = [&](const Unit& u) { return u.pass == p && u.frame == f && wanted(u); };
          if (!hooks_.mask || std::any_of(units.begin(), units.end(), wants)) window_.frame(f);
        }
      }
      std::vector<Image> reads;
      for (const LayerRead& read : pass.reads)
        reads.push_back(hooks_.read(section_.range().first + read.frame_offset, read));
      method_.begin_pass(window_, state_.get(), p, reads);
    }
    // Taken in order from a counter: a parallel loop alone would start in the middle of the list.
    std::atomic<std::size_t> next{0}, done{0};
    parallel_for(0, std::int64_t(units.size()), [&](std::int64_t) {
      if (!stop_.stop_requested() && run_unit(units[next++])) ++done;
    });
    return done == units.size();
  }

  /// Whether a tile has pixels that are asked for.
  bool wanted(const Unit& unit) const {
    const Image* mask = hooks_.mask ? hooks_.mask(unit.frame) : nullptr;
    if (!mask) return true;
    for (int y = unit.tile.y0; y < unit.tile.y1; ++y) {
      for (int x = unit.tile.x0; x < unit.tile.x1; ++x) {
        if (mask->at(x, y) > 0) return true;
      }
    }
    return false;
  }

  /// Returns false if it was stopped: it may be incomplete, and counts for nothing.
  bool run_unit(const Unit& unit) {
    const bool tiled = section_.passes()[unit.pass].domain == Domain::kTiles;
    UnitOutput out;
    out.frames_ = section_.frames();
    std::shared_ptr<const Bytes> kept;
    if (tiled) {
      out.picture_ = &section_.picture(unit.frame);
      if (hooks_.mask) out.mask_ = hooks_.mask(unit.frame);
      kept = section_.kept(unit);
      if (kept) out.kept_ = *kept;
    }
    RenderCounters counters;
    if (!tiled || wanted(unit)) method_.run(window_, state_.get(), unit, out, counters, stop_);
    if (stop_.stop_requested()) return false;
    const RenderTotals totals(counters);
    section_.commit(unit, out.splats_, std::move(out.to_keep_), totals);
    if (hooks_.done) hooks_.done(unit, out.picture_, totals);
    return true;
  }

  void end_passes(int first, int last) {
    for (int p = first; p < last; ++p) method_.end_pass(window_, state_.get(), p, section_.result(p));
    Bytes state;
    ByteWriter out(state);
    if (state_) state_->save(out);
    section_.end_passes(last, std::move(state));
  }

  const Method& method_;
  SceneWindow& window_;
  Section& section_;
  const Part& part_;
  const SectionHooks& hooks_;
  const std::stop_token& stop_;
  std::unique_ptr<SectionState> state_;
};

bool render_section(const Method& method, SceneWindow& window, Section& section, const Part& part,
                    const SectionHooks& hooks, const std::stop_token& stop) {
  return SectionRender(method, window, section, part, hooks, stop).run();
}

}  // namespace tempera
