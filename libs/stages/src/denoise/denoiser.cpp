// SPDX-License-Identifier: Apache-2.0
#include "denoise/denoiser.h"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "decomposition.h"
#include "denoise/input.h"
#include "denoise/residuals.h"
#include "tempera/core/log.h"

namespace tempera::denoise {

namespace {

constexpr int kFew = 16;               ///< samples per pixel, up to which halves are too noisy to be denoised apart
constexpr int kSome = 24;              ///< from which on classes may be filtered apart
constexpr int kMany = 64;              ///< from which on the larger network costs less than the samples that it saves
constexpr float kFirefly = 4;          ///< times the brightest of the other half around that a half may be
constexpr float kOidnFirefly = 64;     ///< the same where Open Image Denoise copes with most of them
constexpr float kWideLikeness = 0.4f;  ///< standard deviations that count as like in wide patches of noisy light

}  // namespace

FrameRange shot_around(int frame, int distance, const FrameRange& reach, const std::vector<int>& cuts) {
  FrameRange out{std::max(frame - distance, reach.first), std::min(frame + distance, reach.last)};
  for (const int cut : cuts) {
    if (cut <= frame) out.first = std::max(out.first, cut);
    if (cut > frame) out.last = std::min(out.last, cut - 1);
  }
  return out;
}

Available::Available(std::span<const LayerDesc> layers) {
  const auto has = [&](const LayerDesc& layer) {
    return std::any_of(layers.begin(), layers.end(), [&](const LayerDesc& d) { return d.name == layer.name; });
  };
  halves = has(layers::color_a()) && has(layers::color_b());
  variance = has(layers::color_variance());
  albedo = has(layers::albedo()), normal = has(layers::normal()), emission = has(layers::emission());
  id = has(layers::object_id());
  photons = has(layers::photon_color()) && (!halves || (has(layers::photon_a()) && has(layers::photon_b())));
  motion = has(layers::motion_forward()) && has(layers::motion_backward());
  // Only the classes of a decomposition are disjoint.
  const bool decomposition = is_decomposed(layers);
  for (const LayerDesc& d : layers) {
    const std::string& name = d.path_class;
    if (!decomposition || !is_class_color(d)) continue;
    if (has(layers::class_layer(name, layers::color_a())) && has(layers::class_layer(name, layers::color_b())))
      classes.push_back(name);
  }
  for (const LayerDesc& d : layers) {
    if (!d.chain.empty() && d == layers::chain_layer(d.chain, layers::albedo()) &&
        has(layers::chain_layer(d.chain, layers::normal())))
      chains.push_back(d.chain);
  }
  any_chain = std::erase(chains, layers::kAnyChain) > 0;
#ifdef TEMPERA_PATH_SPACE_MOTION
  for (const std::string& chain : chains) {
    if (has(layers::chain_layer(chain, layers::motion_forward())) &&
        has(layers::chain_layer(chain, layers::motion_backward())))
      moving.push_back(chain);
  }
#endif
}

std::vector<std::string> Available::losses(bool alone) const {
  std::vector<std::string> out;
  if (!halves) {
    out.push_back(variance ? "no halves (color.a, color.b): how alike pixels are is judged by the noise itself"
                           : "no halves (color.a, color.b) and no color.var: the noise is guessed from the picture, "
                             "and texture taken for noise");
  }
  if (!alone && !motion) out.push_back("no motion vectors in both directions: each frame is denoised alone");
  if (!albedo && !any_chain) out.push_back("no albedo: texture is smoothed with the light on it");
  if (!normal && !any_chain) out.push_back("no normal: edges are known from the noisy picture alone");
  return out;
}

Planes Denoiser::Light::mean() const {
  if (!halves()) return a;
  Planes out = a;
  for_values(out, [&](int c, int y, int x, float v) { return 0.5f * (v + b.row(c, y)[x]); });
  return out;
}

std::shared_ptr<Oidn> choose_method(const Settings& settings) {
  if (settings.method != Method::kOidn && settings.method != Method::kAuto) return nullptr;
  std::shared_ptr<Oidn> oidn;
  try {
    oidn = std::make_shared<Oidn>(settings.oidn_path);
  } catch (const Error&) {
    const bool asked =
        settings.method == Method::kOidn || !settings.oidn_path.empty() || !settings.oidn_version.empty();
    if (asked) throw;
    return nullptr;
  }
  if (!settings.oidn_version.empty() && settings.oidn_version != oidn->version()) {
    throw Error(
        ErrorCode::kUnsupported,
        fmt::format("Open Image Denoise here is version {}, version {} is asked for: frames of one sequence are "
                    "denoised by one version",
                    oidn->version(), settings.oidn_version));
  }
  return oidn;
}

std::string describe_method(const Oidn* oidn) { return oidn ? "oidn " + oidn->version() : "nl_means"; }

Denoiser::Denoiser(StageRun& run, const Settings& settings, std::shared_ptr<Oidn> oidn)
    : run_(run),
      settings_(settings),
      available_(run.in()[0].layers),
      radius_(available_.motion ? settings.radius : 0),
      oidn_(std::move(oidn)),
      recipe_(settings.recipe) {
  if (settings.hold_fireflies.value_or(true)) firefly_ = oidn_ && !settings.hold_fireflies ? kOidnFirefly : kFirefly;
  const Metadata metadata = read_metadata(run.path(run.frames().front()));
  // Classes whose light the first surface scatters belong together: they are divided by the same reflectance.
  std::vector<std::string> scattered;
  for (const ClassInfo& c : classes(metadata)) {
    const bool there =
        std::find(available_.classes.begin(), available_.classes.end(), c.name) != available_.classes.end();
    if (there && c.chains == std::vector<std::string>{"D"}) scattered.push_back(c.name);
  }
  const int samples = samples_of(metadata).value_or(kMany);
  if (recipe_ == Recipe::kAuto) {
    const bool by_class = oidn_ && !scattered.empty() && samples >= kSome && !available_.photons;
    recipe_ = !available_.halves || samples <= kFew ? Recipe::kSingle
              : by_class                            ? Recipe::kComponents
                                                    : Recipe::kHalves;
  }
  few_ = samples <= kFew;
  thorough_ = samples >= kMany;
  if ((recipe_ == Recipe::kComponents && scattered.empty()) ||
      (recipe_ == Recipe::kClasses && available_.classes.empty())) {
    log_info(fmt::format("no classes of a decomposition with halves{}: all light is filtered together",
                         recipe_ == Recipe::kComponents ? " that the first surface scatters" : ""));
    recipe_ = Recipe::kHalves;
  }
  // Neighbouring pixels gather light from the same photons: it has no noise of its own in each of them, and edges that a
  // filter of the other light would take for noise.
  photons_ = available_.photons && (recipe_ == Recipe::kSingle || recipe_ == Recipe::kHalves);
  if (recipe_ == Recipe::kClasses) {
    part_by_class(metadata);
    return;
  }
  if (recipe_ == Recipe::kComponents) {
    std::vector<std::string> rest = available_.chains;
    const bool diffuse = std::erase(rest, "D") > 0;
    views_.push_back(diffuse ? std::vector<std::string>{"D"} : std::vector<std::string>{});
    if (views_[0] != rest) views_.push_back(rest);
    parts_ = {{scattered, 0, false}, {{}, views_.size() - 1, true}};
  } else {
    views_ = {available_.chains};
    parts_ = {{{}, 0, true}};
  }
  // Of few samples what mirrors and glass show is too noisy to be of help.
  const bool show = available_.any_chain && (!few_ || !available_.albedo);
  if (show && (parts_.size() == 1 || available_.chains.empty())) {
    views_ = {{layers::kAnyChain}};
    parts_.back().view = 0;
  }
}

void Denoiser::part_by_class(const Metadata& metadata) {
  const auto index_of = [](std::vector<std::vector<std::string>>& lists, const std::vector<std::string>& chains) {
    const auto at = std::find(lists.begin(), lists.end(), chains);
    if (at != lists.end()) return std::size_t(at - lists.begin());
    lists.push_back(chains);
    return lists.size() - 1;
  };
  views_ = {{}};
  for (const ClassView& view : class_views(available_, metadata)) {
    std::vector<std::string> moving;
    for (const std::string& chain : view.chains) {
      if (chain != "D" &&
          std::find(available_.moving.begin(), available_.moving.end(), chain) != available_.moving.end())
        moving.push_back(chain);
    }
    parts_.push_back({{view.name}, index_of(views_, view.chains), !view.divide, index_of(paths_, moving)});
  }
}

FrameRange Denoiser::around(int frame, int distance) const {
  return shot_around(frame, radius_ > 0 ? distance : 0, run_.in()[0].reach, settings_.cuts);
}

void Denoiser::spent(const std::string& step, double start) { seconds_[step] += cpu_seconds() - start; }

const Denoiser::Source& Denoiser::source(int frame) {
  auto it = sources_.find(frame);
  if (it == sources_.end()) it = sources_.emplace(frame, read(frame)).first;
  return it->second;
}
const Denoiser::Averaged& Denoiser::averaged(int frame) {
  auto it = averaged_.find(frame);
  if (it == averaged_.end()) {
    it = averaged_.emplace(frame, average(frame)).first;
    it->second.trial = try_both(frame);
    forget();
  }
  return it->second;
}
const Denoiser::Denoised& Denoiser::denoised(int frame) {
  auto it = denoised_.find(frame);
  if (it == denoised_.end()) {
    it = denoised_.emplace(frame, denoise(frame)).first;
    forget();
  }
  return it->second;
}

void Denoiser::forget() {
  // Frames are made, denoised and averaged in ascending order; these are the next ones.
  const int denoise = std::max(denoised_.empty() ? 0 : denoised_.rbegin()->first + 1, making_ - radius_);
  const int average = std::max(averaged_.empty() ? 0 : averaged_.rbegin()->first + 1, denoise - 1);
  const auto forget_before = [](auto& frames, int before) { frames.erase(frames.begin(), frames.lower_bound(before)); };
  forget_before(denoised_, making_ - radius_);
  forget_before(averaged_, std::min(making_ - radius_, denoise - 1));
  forget_before(sources_, std::min({making_ - radius_, denoise - 1, average - radius_}));
  for (auto& [f, source] : sources_) {
    if (f < average - radius_) source.light.clear();
    if (f < std::min(making_, denoise - 1)) source.views.clear(), source.emitter = {};
  }
}

Denoiser::Tracks Denoiser::tracks(int frame, int distance, const Part& part) {
  const FrameRange range = around(frame, distance);
  Tracks out;
  for (int f = range.first; f <= range.last; ++f) {
    if (f == frame) continue;
    Track track = follow(frame, f, [&](int g) -> const Surfaces& { return source(g).surfaces[part.moves]; });
    if (!track.empty()) out.emplace(f, std::move(track));
  }
  return out;
}

Denoiser::Averaged Denoiser::average(int frame) {
  const FrameRange range = around(frame, radius_);
  for (int f = range.first; f <= range.last; ++f) source(f);
  const Source& here = source(frame);
  const auto start = cpu_seconds();
  Averaged out;
  Tracks tracks;
  const bool by_halves = recipe_ != Recipe::kSingle && here.light[0].halves();
  for (std::size_t part = 0; part < parts_.size(); ++part) {
    if (part == 0 || parts_[part].moves != parts_[part - 1].moves) tracks = this->tracks(frame, radius_, parts_[part]);
    Light light = here.light[part].light();
    const Planes own = light.mean(), own_variance = light.variance;
    Planes total(own.width(), own.height(), 1, 1);
    Likeness likeness;
    likeness.floor = noise_floor(own);
    // NL-means leaves bright specks unless it has all that averages over time take of them.
    if (oidn_ && parts_[part].moves == 0) likeness.wide_k = kWideLikeness;
    for (const auto& [f, track] : tracks) {
      const PackedLight& there = source(f).light[part];
      const Planes a = gather_nearest(there.a, track), b = there.halves() ? gather_nearest(there.b, track) : Planes();
      const Planes variance = gather_nearest(there.variance, track);
      Planes mean = a;
      if (!b.empty()) for_values(mean, [&](int c, int y, int x, float v) { return 0.5f * (v + b.row(c, y)[x]); });
      const Planes weight = likeness_weights(own, own_variance, mean, variance, track.valid, likeness);
      add_weighted(a, weight, light.a);
      if (light.halves()) {
        add_weighted(b, weight, light.b);
      } else {
        for_values(light.variance, [&](int, int y, int x, float v) {
          const float w = weight.row(0, y)[x];
          return v + w * w * variance.row(0, y)[x];
        });
      }
      for_values(total, [&](int, int y, int x, float v) { return v + weight.row(0, y)[x]; });
      if (!by_halves) out.weights[f].emplace_back(weight);
    }
    divide(light.a, total);
    if (light.halves()) {
      divide(light.b, total);
      light.variance = half_variance(light.a, light.b, kVarianceRadius);
    } else {
      divide(light.variance, total), divide(light.variance, total);
    }
    out.light.emplace_back(light);
  }
  spent("average before", start);
  return out;
}

Denoiser::Pictures Denoiser::average_after(int frame, std::size_t g) {
  const Group& group = denoised(frame)[g];
  const Averaged& noisy = averaged(frame);
  const Light clean = group.light.light();
  const Planes own = clean.mean();
  const bool by_halves = recipe_ != Recipe::kSingle && clean.halves(),
             residuals = settings_.residuals && clean.halves();
  const Planes variance = by_halves ? half_variance(clean.a, clean.b, kVarianceRadius) : Planes();
  const Likeness likeness{.k = 1, .radius = 2, .relative = 1e-6f, .floor = noise_floor(own)};
  const Tracks tracks = this->tracks(frame, radius_, parts_[group.parts[0]]);
  Planes total(own.width(), own.height(), 1, 1);
  std::map<int, Planes> weights;
  Pictures out{own, {}, {}, {}, {}};
  if (residuals) out.clean_a = clean.a, out.clean_b = clean.b;
  for (const auto& [f, track] : tracks) {
    const Denoised& those = denoised(f);
    if (those.size() != denoised(frame).size()) continue;  // what is filtered together there is not so here
    const Light there = those[g].light.light();
    const Planes value = gather_smooth(there.mean(), track);
    Planes weight;
    if (by_halves) {
      const Planes other = gather_nearest(half_variance(there.a, there.b, kVarianceRadius), track);
      weight = likeness_weights(own, variance, value, other, track.valid, likeness);
    } else {
      weight = noisy.weights.at(f)[group.parts[0]].planes();
      for (const std::size_t part : group.parts) {
        const PackedPlanes& w = noisy.weights.at(f)[part];
        for_values(weight, [&](int, int y, int x, float v) { return std::min(v, w.at(0, y, x)); });
      }
    }
    add_weighted(value, weight, out.clean);
    if (residuals) {
      add_weighted(gather_smooth(there.a, track), weight, out.clean_a);
      add_weighted(gather_smooth(there.b, track), weight, out.clean_b);
    }
    for_values(total, [&](int, int y, int x, float v) { return v + weight.row(0, y)[x]; });
    if (residuals) weights.emplace(f, std::move(weight));
  }
  const Planes factor = group.factor.planes();
  for (Planes* p : {&out.clean, &out.clean_a, &out.clean_b}) {
    if (p->empty()) continue;
    divide(*p, total);
    for_values(*p, [&](int c, int y, int x, float v) { return v * factor.row(c, y)[x]; });
  }
  if (!residuals) return out;
  out.a = out.b = Planes(own.width(), own.height(), 3);
  for (const std::size_t part : group.parts) {
    const Planes d = divisor(source(frame), {part});
    for (const bool first : {true, false}) {
      const auto half = [&](const PackedLight& l) { return (first ? l.a : l.b).planes(); };
      Planes light = half(noisy.light[part]);
      for (const auto& [f, weight] : weights)
        add_weighted(gather_smooth(half(averaged(f).light[part]), tracks.at(f)), weight, light);
      divide(light, total);
      for_values(first ? out.a : out.b, [&](int c, int y, int x, float v) {
        return v + light.row(c, y)[x] * (d.empty() ? 1.0f : d.row(c, y)[x]);
      });
    }
  }
  return out;
}

Planes Denoiser::with_residuals(const Pictures& p) {
  if (p.a.empty()) return p.clean;
  const auto start = cpu_seconds();
  Planes out = return_residuals({p.a, p.b, p.clean_a, p.clean_b, p.clean}, 1);
  spent("residuals", start);
  return out;
}

Frame Denoiser::make(int frame) {
  making_ = frame;
  const FrameRange range = around(frame, radius_);
  for (int f = range.first; f <= range.last; ++f) denoised(f);
  const int width = run_.in()[0].width, height = run_.in()[0].height;
  const std::size_t groups = denoised(frame).size();
  std::vector<Planes> clean;  // of each class, or of all light
  Pictures all;
  for (std::size_t g = 0; g < groups; ++g) {
    const auto start = cpu_seconds();
    Pictures pictures = average_after(frame, g);
    spent("average after", start);
    if (recipe_ == Recipe::kClasses) {
      clean.push_back(with_residuals(pictures));
      continue;
    }
    const std::array<Planes Pictures::*, 5> members{&Pictures::clean, &Pictures::clean_a, &Pictures::clean_b,
                                                    &Pictures::a, &Pictures::b};
    for (Planes Pictures::*const member : members) {
      Planes& sum = all.*member;
      const Planes& more = pictures.*member;
      if (g == 0) {
        sum = std::move(pictures.*member);
      } else if (!sum.empty()) {
        for_values(sum, [&](int c, int y, int x, float v) { return v + more.row(c, y)[x]; });
      }
    }
  }
  if (recipe_ != Recipe::kClasses) clean.push_back(with_residuals(all));
  if (photons_) {
    const Planes& photons = source(frame).photons;
    for_values(clean[0], [&](int c, int y, int x, float v) { return std::max(v, 0.0f) + photons.row(c, y)[x]; });
  }
  const Held held = source(frame).held;
  forget();
  Frame out = run_.start(frame);
  const auto write = [&](Image& color, const Planes& from, bool add) {
    for_rows(height, [&](int y) {
      for (int x = 0; x < width; ++x) {
        float* to = color.pixel(x, y);
        for (int c = 0; c < 3; ++c) to[c] = (add ? to[c] : 0) + std::max(from.row(c, y)[x], 0.0f);
      }
    });
  };
  for (std::size_t i = 0; i < clean.size(); ++i) {
    write(out.layer(layers::color().name), clean[i], i > 0);
    if (recipe_ == Recipe::kClasses)
      write(out.layer(layers::class_layer(parts_[i].classes[0], layers::color()).name), clean[i], false);
  }
  if (firefly_ && held.all > 0) out.metadata["tempera/denoise_held_share"] = held.share();
  held_.held += held.held, held_.all += held.all;
  ++frames_;
  return out;
}

std::vector<std::string> Denoiser::notes() const {
  const char* const how = recipe_ == Recipe::kClasses ? "halves of the samples, each class of light paths by itself"
                          : recipe_ == Recipe::kComponents ? "halves of the samples, by class of light paths"
                          : recipe_ == Recipe::kHalves     ? "halves of the samples"
                                                           : "all samples together";
  std::vector<std::string> out{fmt::format("denoised by {}: {}{}", describe_method(oidn_.get()), how,
                                           photons_ ? "; light of photons as it is" : "")};
  if (damaged_ > 0) out.push_back(fmt::format("{} values that are not finite or beyond 1e14 count as 0", damaged_));
  if (firefly_ && held_.all > 0)
    out.push_back(
        fmt::format("{:.2g} % of the light was held back, as it outshines the other half of the samples by far",
                    100 * held_.share()));
  return out;
}

std::string Denoiser::costs() const {
  if (frames_ == 0) return "";
  const SequenceDesc& in = run_.in()[0];
  const double scale = 1e6 / (double(in.width) * in.height * frames_);
  std::string text;
  double sum = 0;
  for (const auto& [step, seconds] : seconds_) {
    text += fmt::format("{}{} {:.2f}", text.empty() ? "" : ", ", step, seconds * scale);
    sum += seconds * scale;
  }
  return fmt::format("microseconds of one core a pixel and frame: {}; together {:.2f}", text, sum);
}

}  // namespace tempera::denoise
