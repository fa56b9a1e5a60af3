// SPDX-License-Identifier: Apache-2.0
#include "tempera/accel/box_index.h"

#include <embree3/rtcore.h>

#include "geometry_cache.h"
#include "tempera/core/error.h"

namespace tempera {

namespace {

constexpr float kLargest = 1e18f;  // of coordinates that Embree takes

bool holds(const Bounds3f& b, const Vec3f& p) {
  return p.x >= b.lo.x && p.x <= b.hi.x && p.y >= b.lo.y && p.y <= b.hi.y && p.z >= b.lo.z && p.z <= b.hi.z;
}

Vec3f clamped(const Vec3f& p) {
  return {std::clamp(p.x, -kLargest, kLargest), std::clamp(p.y, -kLargest, kLargest),
          std::clamp(p.z, -kLargest, kLargest)};
}

}  // namespace

struct BoxIndex::Impl {
  struct Entry {
    Bounds3f box;
    std::uint32_t index = 0;
  };
  std::vector<Entry> entries;
  RTCDevice device = nullptr;
  EmbreeScene scene;

  ~Impl() {
    scene = {};
    if (device) rtcReleaseDevice(device);
  }
};

BoxIndex::BoxIndex(std::span<const Bounds3f> boxes) : impl_(std::make_unique<Impl>()) {
  Impl& s = *impl_;
  TEMPERA_ASSERT(boxes.size() < std::uint32_t(-1));
  for (std::size_t i = 0; i < boxes.size(); ++i) {
    const Bounds3f& b = boxes[i];
    if (b.lo.x <= b.hi.x && b.lo.y <= b.hi.y && b.lo.z <= b.hi.z) s.entries.push_back({b, std::uint32_t(i)});
  }
  if (s.entries.empty()) return;
  s.device = new_device();
  s.scene = EmbreeScene(rtcNewScene(s.device));
  RTCGeometry g = rtcNewGeometry(s.device, RTC_GEOMETRY_TYPE_USER);
  rtcSetGeometryUserPrimitiveCount(g, unsigned(s.entries.size()));
  rtcSetGeometryUserData(g, &s);
  rtcSetGeometryBoundsFunction(
      g,
      [](const RTCBoundsFunctionArguments* args) {
        const Bounds3f& b = static_cast<const Impl*>(args->geometryUserPtr)->entries[args->primID].box;
        const Vec3f lo = clamped(b.lo), hi = clamped(b.hi);
        *args->bounds_o = {lo.x, lo.y, lo.z, 0, hi.x, hi.y, hi.z, 0};
      },
      nullptr);
  rtcCommitGeometry(g);
  rtcAttachGeometry(s.scene.scene, g);
  rtcReleaseGeometry(g);
  rtcCommitScene(s.scene.scene);
  check_device(s.device);
}

BoxIndex::~BoxIndex() = default;
BoxIndex::BoxIndex(BoxIndex&&) noexcept = default;
BoxIndex& BoxIndex::operator=(BoxIndex&&) noexcept = default;

void BoxIndex::query(const Vec3f& p, Visitor visitor, const void* user) const {
  if (impl_->entries.empty()) return;
  if (!(std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)}) <= kLargest)) {
    for (const Impl::Entry& e : impl_->entries) {
      if (holds(e.box, p)) visitor(user, e.index);
    }
    return;
  }
  struct Visit {
    const Impl& index;
    const Vec3f& p;
    Visitor visitor;
    const void* user;
  } visit{*impl_, p, visitor, user};
  RTCPointQuery query{p.x, p.y, p.z, 0, 0};
  RTCPointQueryContext context;
  rtcInitPointQueryContext(&context);
  rtcPointQuery(
      impl_->scene.scene, &query, &context,
      [](RTCPointQueryFunctionArguments* args) {
        const Visit& v = *static_cast<const Visit*>(args->userPtr);
        const Impl::Entry& e = v.index.entries[args->primID];
        if (holds(e.box, v.p)) v.visitor(v.user, e.index);
        return false;  // the radius stays
      },
      &visit);
}

}  // namespace tempera
