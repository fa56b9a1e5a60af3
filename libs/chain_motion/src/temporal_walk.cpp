// SPDX-License-Identifier: Apache-2.0
#include "tempera/chain_motion/temporal_walk.h"

#include <cmath>

namespace tempera {

namespace {

// What does not converge soon is better tried over a shorter time: half of the steps for glass of four sides.
constexpr StepLimits kSoon{.steps = 10, .least = 1.0 / 8};
// Of a step, as a part of the way. Where the prediction misses the surfaces a shorter one may still meet them, as at the rim
// of a ball. Where the corrector does not get to the end, two images most often meet, and no shorter one leads on.
constexpr double kLeastPredicted = 1.0 / 64, kLeastCorrected = 1.0 / 8;

/// First-order motion of the first bend of a chain at its time.
struct Prediction {
  const ChainVertex* bend = nullptr;  ///< null: there is none
  Vec2d rate;                         ///< of its parameters, per second
  bool singular = false;

  explicit Prediction(const SpecularChain& chain) {
    for (const ChainVertex& v : chain.vertices) {
      if (!bend && !v.straight()) bend = &v;
    }
    if (!bend) return;
    const std::vector<SpecularVertex> specular = bends_of(chain);
    const SpecularSystem system(chain.first, specular, chain.last);
    singular = system.singular();
    if (!singular) rate = system.solve({}, {}, 1)[0];
  }
  /// Where the matter of the bend will be at time t, and how far the path will have slid over it.
  Vec3d at(const ChainMatter& matter, const SpecularChain& chain, const ChainEnd& last, double t) const {
    if (!bend) return last.p;
    const SurfaceFrame f = matter.surface(bend->at, t);
    return f.p + (f.dpdu * rate.x + f.dpdv * rate.y) * (t - chain.time);
  }
};

}  // namespace

std::optional<Vec3d> predict(const ChainMatter& matter, const ChainEnds& ends, const SpecularChain& chain, double dt) {
  const Prediction prediction(chain);
  if (prediction.singular) return std::nullopt;
  return prediction.at(matter, chain, ends.last(chain.time + dt), chain.time + dt);
}

WalkState walk_in_time(const ChainMatter& matter, const ChainEnds& ends, double to, double tolerance,
                       SpecularChain& chain, WalkCounts* counts) {
  const double whole = to - chain.time;
  double dt = whole;
  while (chain.time != to) {
    const Prediction prediction(chain);
    if (prediction.singular) return WalkState::kSingular;
    WalkState why = WalkState::kStuck;
    bool halved = false;
    double least = kLeastPredicted;
    for (;; dt /= 2, halved = true) {
      if (std::abs(dt) < least * std::abs(whole)) return why;
      if (counts && counts->spent()) return WalkState::kStuck;
      if (counts) ++counts->temporal;
      const double t = dt == to - chain.time ? to : chain.time + dt;
      const ChainEnd first = ends.first(t), last = ends.last(t);
      const Vec3d normal = ends.last_normal(t);
      auto next = retrace_chain(matter, chain, first, prediction.at(matter, chain, last, t), last, normal, t, why);
      least = next ? kLeastCorrected : kLeastPredicted;
      if (!next) continue;
      why = walk_in_space(matter, last, normal, tolerance, *next, counts, kSoon);
      if (why != WalkState::kDone) continue;
      chain = std::move(*next);
      break;
    }
    const double left = to - chain.time;
    if (!halved) dt *= 2;  // else what is next is as hard, too
    if (std::abs(dt) > std::abs(left)) dt = left;
  }
  return WalkState::kDone;
}

}  // namespace tempera
