// SPDX-License-Identifier: Apache-2.0
#pragma once
// Pictures made by rules: textures and environments for generated scenes, and the patterns that they consist of.
// Values are linear Rec. 709. Not a store for rendered frames, which are `Image` and `Frame`.
#include <cstdint>
#include <functional>
#include <string>
#include <string_view>

#include "tempera/core/grid.h"
#include "tempera/core/vec.h"

namespace tempera::gallery {

using Picture = Grid<Rgb>;  ///< rows from the top

/// color(u, v) at the pixels' centers, u to the right and v down, both in (0,1). Threads: calls it concurrently.
Picture paint(int width, int height, const std::function<Rgb(double u, double v)>& color);
/// A latitude-longitude environment: radiance(d) for unit directions d, as `Environment` maps them.
Picture paint_environment(int width, int height, const std::function<Rgb(const Vec3d& direction)>& radiance);
/// A tangent-space normal map of a surface that repeats: height(u, v) in units of the texture's width.
Picture paint_normals(int width, int height, const std::function<double(double u, double v)>& height_at);

/// 8-bit PNG; `srgb` encodes colors, else values are stored as they are. Gray if no pixel has a color.
/// Result: the same bytes for the same picture.
std::string encode_png(const Picture& picture, bool srgb = true);
/// OpenEXR with 16-bit floats.
std::string encode_exr(const Picture& picture);

/// Gradient noise [Perlin 2002] in about [-1, 1].
double noise(const Vec3d& p, std::uint64_t seed = 0);
/// `octaves` of it, each at twice the frequency and half the size.
double fractal_noise(const Vec3d& p, int octaves, std::uint64_t seed = 0);
/// The same, repeating with period 1 in u and v; `scale` (whole) is the number of cells across.
double tiled_noise(double u, double v, int scale, int octaves, std::uint64_t seed = 0);
/// Uniform in [0,1), a function of the arguments alone.
double random(std::uint64_t seed, std::uint64_t a, std::uint64_t b = 0, std::uint64_t c = 0);

double smooth_step(double a, double b, double x);
Rgb mix(const Rgb& a, const Rgb& b, double t);
/// Linear color of "#rrggbb" in sRGB. Pre: the text has this form.
Rgb hex(std::string_view text);

/// Capital letters, digits and some punctuation in a face of 5 x 7 dots.
/// Result: coverage (0 or 1) of the text at (x, y) in units of a dot, the origin at the top left of the first letter;
/// letters are 6 dots apart.
double text_coverage(std::string_view text, double x, double y);

// Patterns over the plane; lengths are in the units of u and v.
/// 0 or 1 in alternating squares of side 1.
int checker(double u, double v);
/// A cell of a wall of bricks, with the distance to the joint.
struct Brick {
  int column = 0, row = 0;
  double u = 0, v = 0;    ///< position in the brick, 0 to 1
  double from_joint = 0;  ///< distance to the brick's edge
};
/// Bricks of width 1 and `height`, each row shifted by `shift` against the last.
Brick brick(double u, double v, double height, double shift = 0.5);

}  // namespace tempera::gallery
