// SPDX-License-Identifier: Apache-2.0
#include "published.h"

#include <fmt/format.h>

namespace tempera::gallery {

namespace {

std::string escaped(const std::string& text) {  // for an attribute of XML; '$' starts a parameter in Mitsuba's
  std::string out;
  for (const char c : text) {
    if (c == '&')
      out += "&amp;";
    else if (c == '"')
      out += "&quot;";
    else if (c == '<')
      out += "&lt;";
    else if (c == '$')
      out += "\\$";
    else
      out += c;
  }
  return out;
}

}  // namespace

void include_published(GalleryBuilder& b, double fov_x, const std::function<Vec3d(double)>& eye,
                       const std::function<Vec3d(double)>& target) {
  const GalleryScene& s = b.scene();
  std::string keys;
  for (int f = 0; f <= s.last_frame + 2; ++f) {
    const Vec3d from = eye(f), to = target(f);
    keys += fmt::format(
        "      <transform time=\"{:.9g}\"><lookat origin=\"{:.9g}, {:.9g}, {:.9g}\" target=\"{:.9g}, {:.9g}, {:.9g}\" "
        "up=\"0, 1, 0\"/></transform>\n",
        f / s.fps, from.x, from.y, from.z, to.x, to.y, to.z);
  }
  b.scene_file("scene.xml",
               fmt::format("<scene version=\"3.0.0\">\n  <sensor type=\"perspective\" id=\"camera\">\n"
                           "    <float name=\"fov\" value=\"{}\"/>\n    <string name=\"fov_axis\" value=\"x\"/>\n"
                           "    <animation name=\"to_world\">\n{}    </animation>\n"
                           "    <film type=\"hdrfilm\">\n      <integer name=\"width\" value=\"{}\"/>\n"
                           "      <integer name=\"height\" value=\"{}\"/>\n      <rfilter type=\"box\"/>\n    </film>\n"
                           "  </sensor>\n  <include filename=\"{}\"/>\n</scene>\n",
                           fov_x, keys, s.width, s.height, escaped(b.needed_file().string())));
}

}  // namespace tempera::gallery
