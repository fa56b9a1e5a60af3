// SPDX-License-Identifier: Apache-2.0
#pragma once
// A method estimates light transport and writes named layers. It is what a user picks by name. It owns no threads and
// no files: it says into which passes its work divides, and what one unit of a pass does; render_section.h runs them,
// and the pipeline stores what comes of it.
//
//   section   frames of the shot that are rendered together: one by default
//   pass      a step of the work on a section, declared before a ray is traced
//   unit      the quantum of parallelism, checkpoint, resume and division: a tile of a frame, or a batch of light
// paths.
//             What it does depends on its address alone, and on what passes before left.
#include <memory>
#include <span>
#include <stop_token>
#include <string>
#include <vector>

#include "tempera/core/bytes.h"
#include "tempera/core/params.h"
#include "tempera/frames/frame.h"
#include "tempera/frames/layers.h"
#include "tempera/transport/scene_window.h"

namespace tempera {

/// A layer of a frame before the section's that a pass needs as the pass of that name left it there.
struct LayerRead {
  std::string layer;
  int frame_offset = -1;  ///< from the frame that is rendered; < 0
  std::string pass;       ///< the last one that writes the layer
};

/// A layer that units of a pass add to, wherever light arrives.
struct SplatLayer {
  std::string layer;
  double range = 0;  ///< of its sums: see SplatFilm
  double scale = 1;  ///< the layer is the sums times this, beside what other passes wrote to it
};

struct PassDesc {
  enum class Domain {
    kTiles,  ///< a unit is a tile of a frame of the section; it writes its own pixels
    kPaths,  ///< a unit is a number; it splats
  };
  std::string name;  ///< no other pass of the method has it
  Domain domain = Domain::kTiles;
  bool waits = false;            ///< needs all units of the pass before it: without, both may run side by side
  FrameReach scene;              ///< frames around the section that it looks at
  std::vector<LayerRead> reads;  ///< what it takes from frames that were rendered before
  std::int64_t units = 0;        ///< of kPaths
  std::vector<SplatLayer> splats;
  std::uint64_t memory = 0;  ///< bytes that are kept for each pixel of the section from this pass to the next
};

/// What a section's units share: made by Method::begin, and by what passes found out.
class SectionState {
 public:
  virtual ~SectionState() = default;
  /// What end_pass left in it, for checkpoints; the rest is made again by begin and begin_pass.
  virtual void save(ByteWriter& /*out*/) const {}
  /// Errors: Error{kBadInput}.
  virtual void load(ByteReader& /*in*/) {}
};

struct Unit {
  int pass = 0;
  std::int64_t number = 0;  ///< among those of its pass
  int frame = 0;            ///< of kTiles
  Tile tile;                ///< of kTiles
};

/// Where a unit leaves what it made. A unit that is stopped or fails leaves nothing that counts.
class UnitOutput {
 public:
  /// The frame of a unit of kTiles. Shapes: every layer of outputs() and work_layers() has the size of the crop window;
  /// pixel (x, y) of the full picture is stored at (x - settings.x0(), y - settings.y0()).
  Frame& picture() {
    TEMPERA_ASSERT(picture_);
    return *picture_;
  }
  /// Whether pixel (x, y) of the full picture is asked for. The others may stay as they are.
  bool wants(int x, int y) const { return !mask_ || mask_->at(x, y) > 0; }
  /// Whether a picture of this frame of the section is asked for: splats elsewhere are dropped.
  bool wants(int frame) const { return std::binary_search(frames_.begin(), frames_.end(), frame); }

  /// Adds to splat layer `layer` of the pass; pixels as in picture(). Values that are not finite, and places outside of
  /// the crop window, must not come.
  void splat(int layer, int frame, int x, int y, const Rgb& value) { splats_.push_back({layer, frame, x, y, value}); }

  /// What the unit of the same tile kept in the last pass of tiles (kTiles); empty at first.
  std::span<const std::byte> kept() const { return kept_; }
  /// Keeps bytes for the unit of the same tile in the next pass of tiles (kTiles), and for end_pass.
  void keep(Bytes bytes) { to_keep_ = std::move(bytes); }

 private:
  friend class SectionRender;
  friend class Section;
  struct Splat {
    int layer, frame, x, y;
    Rgb value;
  };
  Frame* picture_ = nullptr;
  const Image* mask_ = nullptr;
  std::span<const int> frames_;
  std::vector<Splat> splats_;
  std::span<const std::byte> kept_;
  Bytes to_keep_;
};

/// What all units of a pass made.
struct PassResult {
  /// The picture of each frame that is asked for (kTiles).
  std::span<Frame* const> pictures;
  /// What each unit kept, in their order.
  std::span<const std::shared_ptr<const Bytes>> kept;
};

/// Threads: const and re-entrant.
class Method {
 public:
  virtual ~Method() = default;
  /// Layers that it writes; known before a ray is traced, so that a pipeline is checked up front.
  /// Errors: Error{kUnknownName | kUnsupported} for a requested layer that this method cannot write.
  virtual std::vector<LayerDesc> outputs(const RenderSettings& settings) const = 0;
  /// Layers that units fill beside them for `finish`, and that no file holds.
  virtual std::vector<LayerDesc> work_layers(const RenderSettings& /*settings*/) const { return {}; }

  /// Expressions of light paths that the frames' classifier has to know after those of `settings.classes`.
  virtual std::vector<std::string> own_classes() const { return {}; }

  /// The frames that are rendered together with `frame`, which is one of them: a function of the shot's own sequence,
  /// never of the frames that were asked for.
  virtual FrameRange section(const RenderSettings& /*settings*/, FrameRange /*sequence*/, int frame) const {
    return {frame, frame};
  }
  /// The steps in their order. Errors: SettingError.
  virtual std::vector<PassDesc> passes(const RenderSettings& settings, FrameRange section) const = 0;
  /// Whether a pixel does not depend on which others are rendered: units then skip those that UnitOutput does not want.
  virtual bool renders_single_pixels() const { return false; }

  virtual std::unique_ptr<SectionState> begin(const SceneWindow& /*window*/) const { return nullptr; }
  /// Called before the units of a pass, also of one that a checkpoint continues: works out what they share. `reads`:
  /// the layers of PassDesc::reads. Frames out of the section are asked for here first, not by units. Threads: called
  /// from one, may use parallel_for.
  virtual void begin_pass(const SceneWindow& /*window*/, SectionState* /*state*/, int /*pass*/,
                          std::span<const Image> /*reads*/) const {}
  /// Does one unit. Units of radiance: W/(m^2 sr), scene-linear RGB; time in seconds.
  /// Result:  a function of (scene, settings, parameters, unit) alone: not of threads, order, or the split over
  ///          machines.
  /// Errors:  returns early once `stop` is requested; what it did is then forgotten.
  /// Threads: called concurrently for different units; changes nothing in `state` that another one sees.
  virtual void run(const SceneWindow& window, SectionState* state, const Unit& unit, UnitOutput& out,
                   RenderCounters& counters, std::stop_token stop) const = 0;
  /// Called when all units of a pass are done, if another pass follows that waits for them: what is worked out from all
  /// of them, in the order of units, goes to `state`. Threads: as begin_pass.
  virtual void end_pass(const SceneWindow& /*window*/, SectionState* /*state*/, int /*pass*/,
                        const PassResult& /*result*/) const {}

  /// Makes what needs neighbouring pixels of other tiles, once all units are done. Needs no scene. Threads: as
  /// begin_pass.
  virtual void finish(Frame& /*out*/) const {}

  /// Renders one sample again, to look into what was wrong with it, and returns its radiance. Methods that compute more
  /// from a sample return that if it is not finite where the radiance is.
  virtual Rgb replay(const FrameContext& context, const BadSample& sample) const = 0;
};

/// The expressions of the classifier of frames that `method` renders: the classes of `settings`, and its own.
std::vector<std::string> path_expressions(const Method& method, const RenderSettings& settings);

/// A frame with all layers of `method`, work layers too, zero, and the metadata that goes with them (cryptomatte
/// manifest).
Frame make_frame(const Method& method, const RenderSettings& settings, const Scene& scene);

/// A name that users can choose, its help line, its parameters and its factory.
struct MethodEntry {
  std::string name;
  std::string help;
  std::span<const ParamSpec> params;
  std::unique_ptr<Method> (*make)(const Params& params);
};

/// All methods, in the order of the manual.
std::span<const MethodEntry* const> method_catalog();
/// Errors: Error{kUnknownName} at `loc` with the known names.
const MethodEntry& find_method(const std::string& name, const SourceLoc& loc = {});

}  // namespace tempera
