// SPDX-License-Identifier: Apache-2.0
#pragma once
// Walks on the manifold of paths through mirrors and glass: the path between two ends of which one has moved, within one
// moment. [Jakob 2012, Sec. 4.2; Zimmer 2015, Sec. 4]
#include <functional>
#include <limits>
#include <optional>
#include <vector>

#include "tempera/manifold/specular_system.h"

namespace tempera {

struct ChainVertex;

/// Surfaces that chains are traced through.
class ChainMatter {
 public:
  struct Crossing {
    SurfacePoint point;
    double u = 0, v = 0;  ///< of the point, in double
  };
  virtual ~ChainMatter() = default;
  /// What the line from `o` in unit direction `d` meets first at time t. `from`: the vertex that it leaves; null: the
  /// first end.
  virtual std::optional<Crossing> meet(const Vec3d& o, const Vec3d& d, double t, const ChainVertex* from) const = 0;
  virtual SurfaceFrame surface(const Crossing& at, double t) const = 0;
  /// Index of refraction on the far side of a vertex over that on the side of unit direction `wo`, if the surface refracts;
  /// 1 if it reflects and `refracts` is false; empty if it does not do what is asked for. `f`: surface(at, t).
  virtual std::optional<double> eta(const Crossing& at, const SurfaceFrame& f, const Vec3d& wo, bool refracts,
                                    double t) const = 0;
};

struct ChainVertex {
  ChainMatter::Crossing at;
  bool refracts = false;
  SpecularVertex specular;
  /// Whether light passes straight on: then the vertex constrains nothing, and is no part of the linear system.
  bool straight() const { return refracts && specular.eta == 1; }
};

/// A path of light from its first end to its last one, at a time.
struct SpecularChain {
  double time = 0;
  ChainEnd first, last;
  Vec3d last_normal;  ///< unit, of the surface of a finite last end; zero where it has none
  std::vector<ChainVertex> vertices;
};

/// Where the ends of a chain are at any time: the eye and the matter that is seen.
struct ChainEnds {
  std::function<ChainEnd(double t)> first, last;
  std::function<Vec3d(double t)> last_normal;
};

/// Why a walk ended.
enum class WalkState : std::uint8_t {
  kDone,
  kMissed,    ///< another surface or none was met, or the side changed
  kTotal,     ///< total reflection where the path refracted
  kSingular,  ///< at a fold of the manifold
  kStuck,     ///< steps became too small, or too many
};

struct WalkCounts {
  int spatial = 0, temporal = 0;               ///< steps that were tried
  int most = std::numeric_limits<int>::max();  ///< of both: a walk that needs more is stuck
  bool spent() const { return spatial + temporal >= most; }
};

/// The vertices of a chain that bend light: those of its linear system.
std::vector<SpecularVertex> bends_of(const SpecularChain& chain);
/// The first of them; null if light goes straight on all the way.
const SpecularVertex* first_bend(const SpecularChain& chain);

/// An end infinitely far away in unit direction `d`, with parameters across it.
ChainEnd infinite_end(const Vec3d& d, const Vec3d& dpdt);

/// Where light that comes from unit direction `w` goes on at a vertex, which is away from `w` if it refracts: `d`, unit.
/// Not kDone: it goes nowhere.
WalkState bend(const SpecularVertex& vertex, bool refracts, const Vec3d& w, Vec3d& d);

/// A chain from an eye's ray: follows `refracts` through matter from the first end towards `aim`, and on to the plane of
/// the last end, which the result holds as it is met: `last.p` of a finite one may lie beside the asked for.
/// `like`: the chain that it has to resemble: the same shapes of the same instances; null: any.
std::optional<SpecularChain> trace_chain(const ChainMatter& matter, const ChainEnd& first, const Vec3d& aim,
                                         const ChainEnd& last, const Vec3d& last_normal,
                                         const std::vector<bool>& refracts, double t, const SpecularChain* like,
                                         WalkState* why = nullptr);

/// `like` again at time t, between these ends, its first bend (without any: its last end) near `aim`.
std::optional<SpecularChain> retrace_chain(const ChainMatter& matter, const SpecularChain& like, const ChainEnd& first,
                                           const Vec3d& aim, const ChainEnd& last, const Vec3d& last_normal, double t,
                                           WalkState& why);

/// When a spatial walk gives up. [Jakob 2012, Sec. 4.2]
struct StepLimits {
  int steps = 20;
  double least = 1.0 / 1024;  ///< a step, as a part of what the linear system says
};

/// Moves the last end of `chain` to `last` at the chain's time. `tolerance`: metres of the end, or radians of an infinite
/// one. Leaves a path that ends there on success, the nearest one found else.
WalkState walk_in_space(const ChainMatter& matter, const ChainEnd& last, const Vec3d& last_normal, double tolerance,
                        SpecularChain& chain, WalkCounts* counts = nullptr, const StepLimits& limits = {});

}  // namespace tempera
