// SPDX-License-Identifier: Apache-2.0
#pragma once
// The closed set of lobes. A lobe works in its local shading frame (normal +z) and is either a delta (`sample(wo)`
// gives its one direction) or has `eval(wo, wi)` and `sample(wo, u_choice, u, wi)`, where false means that no light is
// scattered. All are trivially copyable; colors include the material's weights.
#include <type_traits>
#include <utility>
#include <variant>

#include "tempera/shading/lobe_diffuse.h"
#include "tempera/shading/lobe_microfacet.h"
#include "tempera/shading/lobe_principled.h"
#include "tempera/shading/lobe_sheen.h"
#include "tempera/shading/lobe_specular.h"

namespace tempera {

using Lobe = std::variant<DiffuseLobe, SmoothPlasticLobe, RoughPlasticLobe, MirrorLobe<ConductorFresnel>,
                          MirrorLobe<DielectricFresnel>, MirrorLobe<ThinFresnel>, MirrorLobe<SchlickFresnel>,
                          RefractionLobe<DielectricFresnel>, RefractionLobe<SchlickFresnel>, PassageLobe<ThinFresnel>,
                          PassageLobe<SchlickFresnel>, MicrofacetReflectionLobe<ConductorFresnel>,
                          MicrofacetReflectionLobe<DielectricFresnel>, MicrofacetReflectionLobe<SchlickFresnel>,
                          RoughInterfaceLobe<DielectricFresnel>, RoughInterfaceLobe<PrincipledFresnel>,
                          RoughInterfaceLobe<SchlickFresnel>, RoughPassageLobe<SchlickFresnel>, PrincipledDiffuseLobe,
                          ClearcoatLobe, SheenLobe>;
static_assert(std::is_trivially_copyable_v<Lobe>);

/// Calls f with the lobe's own type: a jump, not a call through a table (std::visit makes one for this many types).
template <class F>
void visit_lobe(const Lobe& lobe, F&& f) {
  [&]<std::size_t... I>(std::index_sequence<I...>) {
    (void)((lobe.index() == I && (f(*std::get_if<I>(&lobe)), true)) || ...);
  }
  (std::make_index_sequence<std::variant_size_v<Lobe>>{});
}

}  // namespace tempera
