// SPDX-License-Identifier: Apache-2.0
#include "tempera/methods/section.h"

#include <fmt/format.h>

#include <algorithm>

namespace tempera {

std::vector<Tile> make_tiles(int width, int height, int size) {
  std::vector<Tile> tiles;
  for (int y = 0; y < height; y += size) {
    for (int x = 0; x < width; x += size)
      tiles.push_back({x, y, std::min(x + size, width), std::min(y + size, height)});
  }
  return tiles;
}

RenderTotals& RenderTotals::operator+=(const RenderTotals& o) {
  samples += o.samples;
  rays += o.rays;
  shadow_rays += o.shadow_rays;
  bad_samples += o.bad_samples;
  for (const BadSample& b : o.first_bad) {
    if (first_bad.size() < 16) first_bad.push_back(b);
  }
  return *this;
}

Section::Section(const Method& method, const RenderSettings& settings, const Scene& scene, FrameRange range,
                 std::vector<int> frames, std::vector<PassDesc> passes, int tile_size)
    : range_(range),
      frames_(std::move(frames)),
      passes_(std::move(passes)),
      work_layers_(method.work_layers(settings)),
      width_(settings.x1() - settings.x0()),
      height_(settings.y1() - settings.y0()),
      tile_size_(tile_size),
      tiles_(make_tiles(width_, height_, tile_size)),
      origin_{settings.x0(), settings.y0()} {
  for (std::size_t i = 0; i < frames_.size(); ++i) {
    pictures_.push_back(std::make_unique<Frame>(make_frame(method, settings, scene)));
    all_pictures_.push_back(pictures_.back().get());
  }
  for (std::size_t p = 0; p < passes_.size(); ++p) {
    const bool tiled = passes_[p].domain == PassDesc::Domain::kTiles;
    done_.emplace_back(tiled ? frames_.size() * tiles_.size() : std::size_t(passes_[p].units), char(0));
  }
  make_splats();
}

void Section::make_splats() {
  for (std::size_t p = 0; p < passes_.size(); ++p) {
    for (const SplatLayer& layer : passes_[p].splats) {
      splats_.push_back(
          {int(p), layer, std::make_unique<SplatFilm>(int(frames_.size()), width_, height_, layer.range)});
    }
  }
}

std::size_t Section::frame_index(int frame) const {
  const auto found = std::lower_bound(frames_.begin(), frames_.end(), frame);
  TEMPERA_ASSERT(found != frames_.end() && *found == frame);
  return std::size_t(found - frames_.begin());
}

Frame& Section::picture(int frame) { return *pictures_[frame_index(frame)]; }

std::int64_t Section::units() const {
  std::int64_t n = 0;
  for (const std::vector<char>& d : done_) n += std::int64_t(d.size());
  return n;
}

std::int64_t Section::units_done() const {
  const std::scoped_lock lock(mutex_);
  std::int64_t n = 0;
  for (const std::vector<char>& d : done_) n += std::count(d.begin(), d.end(), 1);
  return n;
}

bool Section::is_done(int pass) const {
  const std::vector<char>& done = done_[pass];
  return std::find(done.begin(), done.end(), 0) == done.end();
}

Unit Section::unit(int pass, std::int64_t number) const {
  Unit u{.pass = pass, .number = number};
  if (passes_[pass].domain != PassDesc::Domain::kTiles) return u;
  const auto tiles = std::int64_t(tiles_.size());
  const Tile& t = tiles_[number % tiles];
  u.frame = frames_[number / tiles];
  u.tile = {t.x0 + origin_.x, t.y0 + origin_.y, t.x1 + origin_.x, t.y1 + origin_.y};
  return u;
}

std::size_t Section::slot(const Unit& unit) const { return std::size_t(unit.number); }

std::shared_ptr<const Bytes> Section::kept(const Unit& unit) const {
  const std::scoped_lock lock(mutex_);
  const Kept& kept = kept_[std::size_t(passes_[unit.pass].domain)];
  return slot(unit) < kept.size() ? kept[slot(unit)] : nullptr;
}

PassResult Section::result(int pass) { return {all_pictures_, kept_of(pass)}; }

void Section::commit(const Unit& unit, std::span<const UnitOutput::Splat> splats, Bytes kept,
                     const RenderTotals& totals) {
  const std::shared_lock whole(film_mutex_);  // all that a unit splats, or nothing
  for (const UnitOutput::Splat& s : splats) {
    int layer = s.layer;
    for (const SplatTarget& target : splats_) {
      if (target.pass != unit.pass || layer-- > 0) continue;
      target.film->add(int(frame_index(s.frame)), s.x, s.y, s.value);
      break;
    }
  }
  const std::scoped_lock lock(mutex_);
  // Of passes that run side by side the first keeps: what waits for them follows it.
  Kept& all = kept_of(unit.pass);
  if (!kept.empty() || (slot(unit) < all.size() && passes_[unit.pass].waits)) {
    if (all.size() <= slot(unit)) all.resize(done_[unit.pass].size());
    all[slot(unit)] = kept.empty() ? nullptr : std::make_shared<const Bytes>(std::move(kept));
  }
  done_[unit.pass][unit.number] = 1;
  totals_ += totals;
}

void Section::end_passes(int ended, Bytes state) {
  const std::scoped_lock lock(mutex_);
  ended_ = ended;
  state_ = std::move(state);
  // Light paths have been worked into the state; tiles go on from what they kept.
  kept_[std::size_t(PassDesc::Domain::kPaths)].clear();
}

void Section::finish(const Method& method) {
  TEMPERA_ASSERT(is_done());
  for (const SplatTarget& target : splats_) {
    for (std::size_t f = 0; f < frames_.size(); ++f) {
      Image& layer = pictures_[f]->layer(target.layer.layer);
      const Image sums = target.film->image(int(f), target.layer.scale);
      for (int y = 0; y < height_; ++y) {
        for (int x = 0; x < width_; ++x) layer.set_rgb(x, y, layer.rgb(x, y) + sums.rgb(x, y));
      }
    }
  }
  for (const auto& picture : pictures_) {
    method.finish(*picture);
    for (const LayerDesc& desc : work_layers_) picture->remove(desc.name);
  }
}

std::uint64_t Section::lost() const {
  std::uint64_t n = 0;
  for (const SplatTarget& target : splats_) n += target.film->lost();
  return n;
}

RenderTotals Section::totals() const {
  const std::scoped_lock lock(mutex_);
  return totals_;
}

std::string Section::layout() const {
  std::string s = fmt::format("{}x{}/{} {}-{}: {};", width_, height_, tile_size_, range_.first, range_.last,
                              fmt::join(frames_, ","));
  for (std::size_t p = 0; p < passes_.size(); ++p) s += fmt::format(" {}:{}", passes_[p].name, done_[p].size());
  if (!pictures_.empty()) {
    for (const Layer& l : pictures_[0]->layers()) s += fmt::format(";{}:{}", l.desc.name, l.image.channels());
  }
  return s;
}

bool Section::has_pixels(const std::vector<std::vector<char>>& done, std::size_t frame, std::size_t tile) const {
  for (std::size_t p = 0; p < passes_.size(); ++p) {
    if (passes_[p].domain == PassDesc::Domain::kTiles && done[p][frame * tiles_.size() + tile]) return true;
  }
  return false;
}

namespace {

/// Calls f(values, bytes) for each row of each layer of a tile; `F` is Frame or const Frame.
template <class F, class Visit>
void for_rows(F& frame, const Tile& tile, Visit&& visit) {
  for (const std::string& name : frame.layer_names()) {
    auto& image = frame.layer(name);
    for (int y = tile.y0; y < tile.y1; ++y) {
      visit(image.pixel(tile.x0, y), std::size_t(tile.x1 - tile.x0) * std::size_t(image.channels()) * sizeof(float));
    }
  }
}

void save(const LayerDesc& desc, ByteWriter& out) {
  out.text(desc.name);
  out.value(std::uint64_t(desc.channels.size()));
  for (const std::string& c : desc.channels) out.text(c);
  out.text(desc.unit);
  out.value(desc.combine), out.value(desc.role);
  out.text(desc.pass);
  out.text(desc.path_class);
  out.text(desc.chain);
}

LayerDesc read_layer(ByteReader& in) {
  LayerDesc desc;
  desc.name = in.text();
  for (auto n = in.value<std::uint64_t>(); n > 0; --n) desc.channels.push_back(in.text());
  desc.unit = in.text();
  in.value(desc.combine), in.value(desc.role);
  desc.pass = in.text();
  desc.path_class = in.text();
  desc.chain = in.text();
  return desc;
}

}  // namespace

void Section::save(ByteWriter& out) const {
  Bytes films;
  std::vector<std::vector<char>> done;
  std::array<Kept, 2> kept;
  Bytes state;
  int ended = 0;
  RenderTotals totals;
  {
    const std::scoped_lock between_units(film_mutex_);
    const std::scoped_lock lock(mutex_);
    ByteWriter film_writer(films);
    for (const SplatTarget& target : splats_) target.film->save(film_writer);
    done = done_, kept = kept_, ended = ended_, state = state_, totals = totals_;
  }
  out.value(width_), out.value(height_), out.value(tile_size_), out.value(origin_), out.value(range_);
  out.values(frames_);
  out.value(std::uint64_t(passes_.size()));
  for (std::size_t p = 0; p < passes_.size(); ++p) {
    const PassDesc& pass = passes_[p];
    out.text(pass.name);
    out.value(pass.domain), out.value(pass.waits), out.value(pass.units);
    out.value(std::uint64_t(pass.splats.size()));
    for (const SplatLayer& s : pass.splats) out.text(s.layer), out.value(s.range), out.value(s.scale);
    out.values(done[p]);
  }
  out.value(std::uint64_t(work_layers_.size()));
  for (const LayerDesc& d : work_layers_) tempera::save(d, out);
  out.value(ended);
  out.values(state);
  for (const std::uint64_t n : {totals.samples, totals.rays, totals.shadow_rays, totals.bad_samples}) out.value(n);
  out.values(totals.first_bad);
  for (const Kept& of_domain : kept) {
    out.value(std::uint64_t(of_domain.size()));
    for (const auto& k : of_domain) out.values(k ? *k : Bytes());
  }
  out.bytes(films.data(), films.size());
  // Tiles that are done do not change any more in the layers of their pass; what a later pass is writing now will be
  // written again.
  for (std::size_t f = 0; f < frames_.size(); ++f) {
    const Frame& picture = *pictures_[f];
    out.value(std::uint64_t(picture.layers().size()));
    for (const Layer& l : picture.layers()) tempera::save(l.desc, out);
    save_metadata(picture.metadata, out);
    for (std::size_t t = 0; t < tiles_.size(); ++t) {
      if (has_pixels(done, f, t))
        for_rows(picture, tiles_[t], [&](const float* row, std::size_t n) { out.bytes(row, n); });
    }
  }
}

std::unique_ptr<Section> Section::read(ByteReader& in) {
  const auto damaged = [] { return Error(ErrorCode::kBadInput, "it is damaged"); };
  std::unique_ptr<Section> section(new Section());
  Section& s = *section;
  in.value(s.width_), in.value(s.height_), in.value(s.tile_size_), in.value(s.origin_), in.value(s.range_);
  constexpr int kMost = 1 << 20;
  if (s.width_ < 0 || s.height_ < 0 || s.width_ > kMost || s.height_ > kMost || s.tile_size_ < 1) throw damaged();
  s.tiles_ = make_tiles(s.width_, s.height_, s.tile_size_);
  in.values(s.frames_);
  for (auto n = in.value<std::uint64_t>(); n > 0; --n) {
    PassDesc pass;
    pass.name = in.text();
    in.value(pass.domain), in.value(pass.waits), in.value(pass.units);
    for (auto m = in.value<std::uint64_t>(); m > 0; --m) {
      SplatLayer layer;
      layer.layer = in.text();
      in.value(layer.range), in.value(layer.scale);
      if (!(layer.range > 0)) throw damaged();
      pass.splats.push_back(std::move(layer));
    }
    std::vector<char> done;
    in.values(done);
    const bool tiled = pass.domain == PassDesc::Domain::kTiles;
    if (done.size() != (tiled ? s.frames_.size() * s.tiles_.size() : std::size_t(pass.units))) throw damaged();
    s.done_.push_back(std::move(done));
    s.passes_.push_back(std::move(pass));
  }
  for (auto n = in.value<std::uint64_t>(); n > 0; --n) s.work_layers_.push_back(read_layer(in));
  in.value(s.ended_);
  if (s.ended_ < 0 || s.ended_ > int(s.passes_.size())) throw damaged();
  in.values(s.state_);
  RenderTotals& totals = s.totals_;
  for (std::uint64_t* n : {&totals.samples, &totals.rays, &totals.shadow_rays, &totals.bad_samples}) in.value(*n);
  in.values(totals.first_bad);
  for (Kept& kept : s.kept_) {
    for (auto n = in.value<std::uint64_t>(); n > 0; --n) {
      Bytes bytes;
      in.values(bytes);
      kept.push_back(bytes.empty() ? nullptr : std::make_shared<const Bytes>(std::move(bytes)));
    }
  }
  s.make_splats();
  for (const SplatTarget& target : s.splats_) target.film->load(in);
  for (std::size_t f = 0; f < s.frames_.size(); ++f) {
    auto picture = std::make_unique<Frame>(s.width_, s.height_);
    for (auto n = in.value<std::uint64_t>(); n > 0; --n) picture->create(read_layer(in));
    read_metadata(picture->metadata, in);
    for (std::size_t t = 0; t < s.tiles_.size(); ++t) {
      if (s.has_pixels(s.done_, f, t))
        for_rows(*picture, s.tiles_[t], [&](float* row, std::size_t n) { in.bytes(row, n); });
    }
    s.all_pictures_.push_back(picture.get());
    s.pictures_.push_back(std::move(picture));
  }
  return section;
}

void Section::load(ByteReader& in) {
  const std::unique_ptr<Section> saved = read(in);
  if (saved->layout() != layout()) throw Error(ErrorCode::kBadInput, "it is of other frames or layers");
  pictures_ = std::move(saved->pictures_);
  all_pictures_ = std::move(saved->all_pictures_);
  splats_ = std::move(saved->splats_);
  done_ = std::move(saved->done_);
  kept_ = std::move(saved->kept_);
  ended_ = saved->ended_;
  state_ = std::move(saved->state_);
  totals_ = std::move(saved->totals_);
}

std::string Section::missing() const {
  std::string text;
  for (std::size_t p = 0; p < passes_.size(); ++p) {
    const auto n = std::count(done_[p].begin(), done_[p].end(), 0);
    if (n > 0)
      text += fmt::format("{}{} of {} units of the pass \"{}\"", text.empty() ? "" : ", ", n, done_[p].size(),
                          passes_[p].name);
  }
  return text;
}

void Section::merge(const Section& other) {
  if (layout() != other.layout()) throw Error(ErrorCode::kBadInput, "it is of other frames or layers");
  if (ended_ != other.ended_ || state_ != other.state_)
    throw Error(ErrorCode::kBadInput, "it continues another state of the passes before");
  for (std::size_t p = 0; p < passes_.size(); ++p) {
    std::int64_t doubled = 0;
    for (std::size_t i = 0; i < done_[p].size(); ++i) doubled += done_[p][i] && other.done_[p][i];
    // What both hold of passes that have ended is the same.
    if (doubled > 0 && int(p) >= ended_) {
      throw Error(ErrorCode::kBadInput, fmt::format("{} of {} units of the pass \"{}\" are in another part, too",
                                                    doubled, done_[p].size(), passes_[p].name));
    }
  }
  for (std::size_t p = 0; p < passes_.size(); ++p) {
    for (std::size_t i = 0; i < done_[p].size(); ++i) {
      if (!other.done_[p][i] || done_[p][i]) continue;
      done_[p][i] = 1;
      const Kept& others = other.kept_[std::size_t(passes_[p].domain)];
      if (Kept& own = kept_of(int(p)); i < others.size() && others[i]) {
        if (own.size() <= i) own.resize(done_[p].size());
        own[i] = others[i];
      }
      if (passes_[p].domain != PassDesc::Domain::kTiles) continue;
      const std::size_t f = i / tiles_.size();
      const Tile& tile = tiles_[i % tiles_.size()];
      for (const std::string& name : pictures_[f]->layer_names()) {
        Image& to = pictures_[f]->layer(name);
        const Image& from = std::as_const(*other.pictures_[f]).layer(name);
        for (int y = tile.y0; y < tile.y1; ++y) {
          const float* first = from.pixel(tile.x0, y);
          std::copy(first, first + std::ptrdiff_t(tile.x1 - tile.x0) * from.channels(), to.pixel(tile.x0, y));
        }
      }
    }
  }
  for (std::size_t i = 0; i < splats_.size(); ++i) {
    if (splats_[i].pass >= ended_) splats_[i].film->merge(*other.splats_[i].film);
  }
  totals_ += other.totals_;
}

}  // namespace tempera
