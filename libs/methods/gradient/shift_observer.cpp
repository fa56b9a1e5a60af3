// SPDX-License-Identifier: Apache-2.0
#include "shift_observer.h"

#include "shift_mapping.h"

namespace tempera {

template <bool kByClass>
void ShiftObserver<kByClass>::start(const Vertex* first, const Rgb& emitted) {
  if (first) beta_ = absorption(*first, length(first->s.p - camera_.ray.o));
  CameraSample camera = camera_;
  for (std::size_t j = 0; j < 4; ++j) {
    Offset& o = offsets_[j];
    if (o.state == Offset::kOutside) continue;
    camera.film = camera_.film + kNeighbours[j];
    camera.ray = context_.camera.ray(camera.film, camera.lens, camera.time);
    Ray ray{camera.ray.o, camera.ray.d, camera.ray.tmin, camera.ray.tmax, camera.time};
    int passed = 0;
    float pass_probability = 1;
    const EdgeEnd end = follow(context_, camera_.stream, 0, ray, &camera, o.vertex, passed, pass_probability);
    rays_ += std::uint64_t(passed) + 1;
    Rgb offset_emitted;
    if (end == EdgeEnd::kEnvironment) {
      if (!options_.hide_emitters) offset_emitted = context_.lights.environment(ray.d, ray.time, true);
    } else if (end == EdgeEnd::kSurface) {
      o.beta *= absorption(o.vertex, length(o.vertex.s.p - camera.ray.o));
      if (o.vertex.shape->emission && !options_.hide_emitters) {
        offset_emitted = o.beta * context_.lights.emitted(o.vertex.hit.point, o.vertex.s);
      }
    }
    // What the camera sees directly is a path of one edge, and every such path shifts to every other.
    o.g += (offset_emitted - beta_ * emitted) * 0.5f;
    if constexpr (kByClass) add_to_classes(o, Rgb(1.0f), offset_emitted, beta_ * emitted, 0.5f);
    if (!first || end != EdgeEnd::kSurface) {
      o.state = Offset::kDead;
    } else {
      o.vertex.make_bsdf();
    }
  }
}

template <bool kByClass>
void ShiftObserver<kByClass>::next_event(const Vertex& at, const LightSample& light, const BsdfEval& f, float visible) {
  const float pl2 = sqr(light.pdf);
  if (!(pl2 > 0)) return;
  const Rgb f_sum = f.sum();
  const Rgb le = light.radiance * (visible / light.pdf);
  const Rgb base = beta_ * f_sum * le;
  if constexpr (kByClass) owned_ = owned(light);
  const auto density = [&](const Rgb& value, float pdf, float v) {  // nothing is sampled where nothing is carried
    return v > 0 && !light.delta && !is_black(value) ? sqr(pdf) : 0.0f;
  };
  const float pb2 = density(f_sum, f.pdf, visible);
  const bool base_connects = connects(at, false);
  Vec3f light_position, light_normal;
  if (light.point &&
      std::any_of(offsets_.begin(), offsets_.end(), [](const Offset& o) { return o.state == Offset::kFree; }))
    light_position = context_.rays.position(*light.point, camera_.time, &light_normal);
  for (Offset& o : offsets_) {
    Rgb offset;
    [[maybe_unused]] BsdfEval f_classes;  // of the offset path
    float others = 0;                     // squared densities of the offset's own ways to sample the pair, over pl2
    switch (o.state) {
      case Offset::kOutside:
        continue;
      case Offset::kDead:
        break;
      case Offset::kJoined:
        if constexpr (kByClass) f_classes = f;
        offset = o.beta * f_sum * le;
        others = sqr(o.rho) * (pl2 + pb2);
        break;
      case Offset::kFresh: {
        if (!samples_lights(o.vertex.bsdf)) break;
        const BsdfEval f_offset = o.vertex.bsdf.eval(o.vertex.s.wo, light.wi);
        if constexpr (kByClass) f_classes = f_offset;
        const Rgb value = f_offset.sum();
        offset = o.beta * value * le;
        others = sqr(o.rho) * (pl2 + density(value, f_offset.pdf, visible));
        break;
      }
      case Offset::kFree: {
        // Where the base path copies half vectors its BSDF samples alone are compared.
        if (!light.delta && !(base_connects && connects(o.vertex, false))) continue;
        if (!samples_lights(o.vertex.bsdf)) break;
        const ShadingPoint& s = o.vertex.s;
        const auto there = context_.lights.connect(light, s.p, camera_.time);
        if (!there) break;
        const BsdfEval f_offset = o.vertex.bsdf.eval(s.wo, there->wi);
        if constexpr (kByClass) f_classes = f_offset;
        const Rgb value = f_offset.sum();
        float v = 0;  // never asked for where nothing is carried
        if (!is_black(value)) {
          ++rays_;
          v = visibility(context_, s, there->wi, there->distance);
        }
        float jacobian = 1;
        if (light.point) jacobian = reconnection_jacobian(at.s.p, s.p, light_position, light_normal);
        offset = o.beta * value * there->radiance * (jacobian * v / light.pdf);
        others = sqr(o.rho * jacobian) * (sqr(there->pdf) + density(value, f_offset.pdf, v));
        break;
      }
    }
    const float weight = pl2 / (pl2 + pb2 + others);
    add(o, offset, f_classes, base, f, weight, owned_);
  }
}

template <bool kByClass>
void ShiftObserver<kByClass>::add(Offset& o, const Rgb& beta, const Rgb& radiance, const Rgb& base, float weight,
                                  [[maybe_unused]] const Rgb& owned) const {
  if constexpr (kByClass) {
    if (gathered_) return add_others(o, beta, radiance, nullptr, owned, base, nullptr, weight);
  }
  o.g += (beta * radiance - base) * weight;
  if constexpr (kByClass) add_to_classes(o, beta, radiance, base, weight);
}

template <bool kByClass>
void ShiftObserver<kByClass>::lose(Offset& o, const Rgb& base, float weight) const {
  if constexpr (kByClass) {
    if (gathered_) return add_others(o, {}, {}, nullptr, {}, base, nullptr, weight);
  }
  o.g -= base * weight;
  if constexpr (kByClass) add_to_classes(o, {}, {}, base, weight);
}

template <bool kByClass>
void ShiftObserver<kByClass>::add(Offset& o, const Rgb& offset, [[maybe_unused]] const BsdfEval& f_offset,
                                  const Rgb& base, [[maybe_unused]] const BsdfEval& f, float weight,
                                  [[maybe_unused]] const Rgb& owned) const {
  if constexpr (kByClass) {
    if (gathered_) return add_others(o, Rgb(1.0f), offset, &f_offset, owned, base, &f, weight);
  }
  o.g += (offset - base) * weight;
  if constexpr (kByClass) add_to_classes(o, offset, f_offset, base, f, weight);
}

template <bool kByClass>
void ShiftObserver<kByClass>::add_others(Offset& o, const Rgb& beta, const Rgb& radiance, const BsdfEval* f_offset,
                                         const Rgb& owned, const Rgb& base, const BsdfEval* f, float weight) const {
  if constexpr (kByClass) {
    const auto add = [&](const WeightedStates& states, const Rgb& light, const BsdfEval* scatters, const Rgb& part) {
      const auto add_part = [&](const Rgb& c, std::uint32_t without) {
        o.g += scatters ? states.add_to(context_.classifier, c, scatters->f_cos, o.by_class.classes, without)
                        : states.add_to(context_.classifier, c, o.by_class.classes, without);
      };
      add_part(light * part, gathered_->classes());
      add_part(light * (Rgb(1.0f) - part), 0);
    };
    add(o.by_class.states, beta * radiance * weight, f_offset, owned);
    add(by_class_.states, base * -weight, f, owned_);
  }
}

template <bool kByClass>
Rgb ShiftObserver<kByClass>::owned(const LightSample& light) const {
  if (!gathered_) return {};
  const bool one = std::isfinite(light.distance) || light.delta;  // not all that shines from there
  return one ? Rgb(owned_lights_[light.light] ? 1.0f : 0.0f) : owned(nullptr, light.wi, light.radiance);
}

template <bool kByClass>
Rgb ShiftObserver<kByClass>::owned(const Vertex* to, const Vec3f& wi, const Rgb& emitted) const {
  if (!gathered_ || is_black(emitted)) return {};
  if (to) return Rgb(owned_lights_[context_.lights.light_of(to->hit.point)] ? 1.0f : 0.0f);
  return owned_part(context_.lights, wi, camera_.time, false, owned_lights_, emitted);
}

template <bool kByClass>
void ShiftObserver<kByClass>::add_to_classes(Offset& o, const Rgb& beta, const Rgb& radiance, const Rgb& base,
                                             float weight) const {
  if constexpr (kByClass) {
    o.by_class.states.add_to(context_.classifier, beta * radiance * weight, o.by_class.classes);
    by_class_.states.add_to(context_.classifier, base * -weight, o.by_class.classes);
  }
}

template <bool kByClass>
void ShiftObserver<kByClass>::add_to_classes(Offset& o, const Rgb& offset, const BsdfEval& f_offset, const Rgb& base,
                                             const BsdfEval& f, float weight) const {
  if constexpr (kByClass) {
    o.by_class.states.add_to(context_.classifier, offset * weight, f_offset.f_cos, o.by_class.classes);
    by_class_.states.add_to(context_.classifier, base * -weight, f.f_cos, o.by_class.classes);
  }
}

template <bool kByClass>
void ShiftObserver<kByClass>::scatter(const Extension& e, const BsdfEval& f_by_event, float pdf, float jacobian,
                                      float eta, Offset& o, [[maybe_unused]] bool straight) const {
  const Rgb f = f_by_event.sum();
  if constexpr (kByClass) o.by_class.states.scatter(context_.classifier, f_by_event.f_cos, straight);
  o.beta *= f * (jacobian / (e.sample.pdf * e.survival));
  o.rho *= jacobian * pdf / e.sample.pdf;
  o.roulette *= max_component(f) / pdf;
  o.eta2 *= eta * eta;
}

template <bool kByClass>
void ShiftObserver<kByClass>::extend(const Extension& e) {
  if (connects(e.from, e.sample.delta)) {
    connected_ = true;
  } else if (connected_ && !rare_) {
    rare_ = true;
    common_radiance_ = e.gathered - apart_;
    for (std::size_t j = 0; j < 4; ++j) common_g_[j] = offsets_[j].g;
  }
  beta_ *= e.step;
  if constexpr (kByClass) {
    by_class_.states.scatter(context_.classifier, e.sample.f_cos, is_passage(e.sample));
    owned_ = owned(e.to, e.sample.wi, e.emitted);
  }
  if (e.to) beta_ *= absorption(*e.to, length(e.to->s.p - e.from.s.p));
  const Rgb base = beta_ * e.emitted;
  const float base_weight = 1 + sqr(e.light_pdf / e.sample.pdf);  // (pB^2 + pL^2) / pB^2
  for (Offset& o : offsets_) {
    if (o.state == Offset::kOutside) continue;
    if (o.state == Offset::kDead) {
      lose(o, base, 1 / base_weight);
      continue;
    }
    if (o.state != Offset::kFree) {
      extend_shared(e, base, base_weight, o);
    } else if (connects(e.from, e.sample.delta) && connects(o.vertex, false) && connects_to(e.to)) {
      reconnect(e, base, base_weight, o);
    } else {
      copy_half_vector(e, base, o);
    }
    if (o.state != Offset::kDead && e.roulette) {
      // Each of the two paths survives with its own probability.
      const float q = std::min(o.roulette * o.eta2, kMaxContinue);
      o.rho *= q / e.survival;
      o.roulette /= q;
    }
  }
}

template <bool kByClass>
void ShiftObserver<kByClass>::gather(const Vertex& at, std::span<const GatheredLight::Arrival> arrivals,
                                     [[maybe_unused]] const Rgb& found, [[maybe_unused]] bool first,
                                     [[maybe_unused]] bool coarse, [[maybe_unused]] int most_edges) {
  if constexpr (kByClass) {
    const auto add = [&](const WeightedStates& states, const Rgb& c, const GatheredLight::Arrival& a,
                         std::span<Rgb> classes) {
      states.add_joined(context_.classifier, c, gathered_->classes(), classes,
                        [&](LightPathClassifier::State s) { return a.ends[s]; });
    };
    const auto add_offset = [&](Offset& o, const Vertex& v, std::span<const GatheredLight::Arrival> arriving) {
      const Rgb beta = o.beta * (1 / (1 + sqr(o.rho)));
      for (const GatheredLight::Arrival& a : arriving) {
        const Rgb c = beta * scattered(v, a);
        o.g += c;
        add(o.by_class.states, c, a, o.by_class.classes);
      }
    };
    if (first) {
      apart_ = found;
      if (by_class_.classes.empty()) return;
      for (const GatheredLight::Arrival& a : arrivals)
        add(by_class_.states, beta_ * scattered(at, a), a, by_class_.classes);
      return;
    }
    // Nothing is gathered where nothing is diffuse: from there the path back would not be compared with this one.
    const auto gathers = [](const Offset& o) { return o.state == Offset::kFree && o.vertex.bsdf.has_non_delta(); };
    const auto is_shared = [](const Offset& o) { return o.state == Offset::kJoined || o.state == Offset::kFresh; };
    for (const GatheredLight::Arrival& a : arrivals) {
      const Rgb base = beta_ * scattered(at, a);
      for (Offset& o : offsets_) {
        if (o.state == Offset::kOutside) continue;
        const Rgb c = base * (is_shared(o) || gathers(o) ? -1 / (1 + sqr(o.rho)) : -1.0f);
        o.g += c;
        add(by_class_.states, c, a, o.by_class.classes);
      }
    }
    for (Offset& o : offsets_) {
      if (o.state == Offset::kJoined) add_offset(o, at, arrivals);
      if (o.state == Offset::kFresh) add_offset(o, o.vertex, arrivals);
    }
    // Asking again ends the life of `arrivals`.
    for (Offset& o : offsets_) {
      if (gathers(o))
        add_offset(o, o.vertex, gathered_->arriving(o.vertex, camera_.time, camera_.index, coarse, most_edges));
    }
  }
}

/// The offset path shares the vertex from which the base path goes on.
template <bool kByClass>
void ShiftObserver<kByClass>::extend_shared(const Extension& e, const Rgb& base, float base_weight, Offset& o) const {
  const float pb = e.sample.pdf, pl = e.light_pdf;
  const Rgb arriving = e.to ? absorption(*e.to, length(e.to->s.p - e.from.s.p)) : Rgb(1.0f);
  const float eta = e.sample.transmitted ? e.sample.eta : 1.0f;
  BsdfEval f = e.sample;
  float pdf = pb, others = 0;
  if (o.state == Offset::kJoined) {
    others = sqr(o.rho) * base_weight;
  } else {
    f = e.sample.delta ? BsdfEval{} : o.vertex.bsdf.eval(o.vertex.s.wo, e.sample.wi);
    pdf = is_black(f.sum()) ? 0.0f : f.pdf;
    others = sqr(o.rho) * (sqr(pdf) + (samples_lights(o.vertex.bsdf) ? sqr(pl) : 0.0f)) / sqr(pb);
  }
  if (!(pdf > 0)) {
    lose(o, base, 1 / (base_weight + others));
    o.state = Offset::kDead;
    return;
  }
  scatter(e, f, pdf, 1, eta, o, is_passage(e.sample));
  o.beta *= arriving;
  add(o, o.beta, e.emitted, base, 1 / (base_weight + others), owned_);
  o.state = Offset::kJoined;
}

/// The offset path goes to the base path's next vertex.
template <bool kByClass>
void ShiftObserver<kByClass>::reconnect(const Extension& e, const Rgb& base, float base_weight, Offset& o) {
  const ShadingPoint& s = o.vertex.s;
  const Vec3f from = s.p;
  Vec3f wi = e.sample.wi;
  float distance = kInfinity, jacobian = 1;
  if (e.to) {
    const Vec3f d = e.to->s.p - from;
    distance = length(d);
    if (!(distance > 0)) {
      lose(o, base, 1 / base_weight);
      o.state = Offset::kDead;
      return;
    }
    wi = d * (1 / distance);
    jacobian = reconnection_jacobian(e.from.s.p, from, e.to->s.p, e.to->s.ng);
  }
  const BsdfEval f = o.vertex.bsdf.eval(s.wo, wi);
  const Rgb value = f.sum();
  float visible = 0;
  if (!is_black(value) && jacobian > 0) {
    ++rays_;
    visible = visibility(context_, s, wi, distance);
  }
  const float pdf = visible > 0 ? f.pdf : 0.0f;
  float eta = 1;
  if (dot(wi, s.frame.n) * dot(s.wo, s.frame.n) < 0) {
    const float refracts = o.vertex.bsdf.rough_eta(s.wo);
    if (refracts > 0) eta = refracts;  // else a reflection about a bent or mapped normal
  }
  const bool lights = samples_lights(o.vertex.bsdf) && e.light_pdf > 0;

  // From here on the vertex is the next one.
  float light_pdf = 0;
  Rgb emitted = e.emitted, arriving(1.0f);
  if (e.to) {
    o.vertex.hit = e.to->hit;
    o.vertex.shape = e.to->shape;
    o.vertex.s = e.to->s;
    o.vertex.s.wo = -wi;
    arriving = absorption(o.vertex, distance);
    emitted = e.to->shape->emission ? context_.lights.emitted(o.vertex.hit.point, o.vertex.s) : Rgb(0.0f);
    if (lights) light_pdf = context_.lights.pdf(o.vertex.hit.point, o.vertex.s, from, distance);
  } else if (lights) {
    light_pdf = context_.lights.environment_pdf(wi, camera_.time, from);
  }
  // An emitter that is occluded from the offset path is still what its next-event estimation would try.
  const float others = sqr(o.rho * jacobian / e.sample.pdf) * (sqr(pdf) + sqr(light_pdf));
  if (!(pdf > 0)) {
    lose(o, base, 1 / (base_weight + others));
    o.state = Offset::kDead;
    return;
  }
  scatter(e, f, pdf, jacobian, eta, o);
  o.beta *= arriving * (visible / e.pass_probability);
  add(o, o.beta, emitted, base, 1 / (base_weight + others), owned_);
  if (!e.to) {
    o.state = Offset::kDead;
    return;
  }
  o.vertex.make_bsdf();
  o.state = Offset::kFresh;
}

/// The offset path scatters about the same local half vector and finds its own next vertex.
template <bool kByClass>
void ShiftObserver<kByClass>::copy_half_vector(const Extension& e, const Rgb& base, Offset& o) {
  const auto fail = [&] {
    lose(o, base, 1);
    o.state = Offset::kDead;
  };
  const ShadingPoint& s = o.vertex.s;
  const Bsdf& bsdf = o.vertex.bsdf;
  const BsdfSample& sample = e.sample;
  Vec3f wi;
  BsdfEval f;
  float pdf = 0, jacobian = 1, eta = 1;
  bool straight = false;
  if (sample.delta) {
    // The same lobe of the same kind; the lobes of different materials have no common numbering.
    const int i = sample.lobe;
    if (i >= bsdf.size() || bsdf.lobe(i).index() != e.from.bsdf.lobe(i).index()) return fail();
    const auto there = bsdf.sample_delta(i, s.wo);
    if (!there || there->transmitted != sample.transmitted) return fail();
    wi = there->wi;
    f = *there;
    pdf = there->pdf;
    eta = there->transmitted ? there->eta : 1;
    straight = is_passage(*there);
  } else {
    const ShadingPoint& x = e.from.s;
    const Vec3f wo = x.frame.to_local(x.wo), wi_base = x.frame.to_local(sample.wi);
    const Vec3f wo_offset = s.frame.to_local(s.wo);
    if (wo.z * wo_offset.z <= 0) return fail();
    std::optional<ShiftedDirection> shifted;
    if (wo.z * wi_base.z > 0) {
      shifted = shift_reflection(wo, wi_base, wo_offset);
    } else {
      const float eta_base = e.from.bsdf.rough_eta(x.wo);
      eta = bsdf.rough_eta(s.wo);
      if (eta_base == 0 || eta == 0 || (eta_base == 1) != (eta == 1)) return fail();
      shifted =
          eta == 1 ? shift_passage(wo, wi_base, wo_offset) : shift_refraction(wo, wi_base, eta_base, wo_offset, eta);
    }
    if (!shifted) return fail();
    wi = s.frame.to_world(shifted->wi);
    jacobian = shifted->jacobian;
    f = bsdf.eval(s.wo, wi);
    pdf = f.pdf;
  }
  if (!(pdf > 0) || is_black(f.sum()) || !(jacobian > 0) || !std::isfinite(jacobian)) return fail();

  const bool could_connect = connects(e.from, sample.delta) && connects(o.vertex, sample.delta);
  const Vec3f from = s.p;
  Ray ray{context_.rays.offset_origin(s.p, s.ng, wi), wi, 0, kInfinity, camera_.time};
  Vertex next;
  int passed = 0;
  float pass_probability = 1;
  const EdgeEnd end = follow(context_, camera_.stream, e.index, ray, nullptr, next, passed, pass_probability);
  rays_ += std::uint64_t(passed) + 1;
  if (end == EdgeEnd::kLost || (end == EdgeEnd::kEnvironment) != !e.to) return fail();
  if (end == EdgeEnd::kSurface) next.make_bsdf();
  // The way back would reconnect instead.
  if (could_connect && connects_to(end == EdgeEnd::kSurface ? &next : nullptr)) return fail();

  scatter(e, f, pdf, jacobian, eta, o, straight);
  Rgb emitted;
  if (end == EdgeEnd::kSurface) {
    o.beta *= absorption(next, length(next.s.p - from));
    if (next.shape->emission) emitted = context_.lights.emitted(next.hit.point, next.s);
  } else {
    emitted = context_.lights.environment(wi, camera_.time);
  }
  add(o, o.beta, emitted, base, 1 / (1 + sqr(o.rho)), owned(end == EdgeEnd::kSurface ? &next : nullptr, wi, emitted));
  if (end == EdgeEnd::kSurface) {
    o.vertex = next;
  } else {
    o.state = Offset::kDead;
  }
}

template class ShiftObserver<false>;
template class ShiftObserver<true>;

}  // namespace tempera
