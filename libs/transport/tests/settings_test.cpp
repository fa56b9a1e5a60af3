// SPDX-License-Identifier: Apache-2.0
#include "tempera/transport/settings.h"

#include <gtest/gtest.h>

namespace tempera {
namespace {

using Chains = std::vector<std::string>;

TEST(ChainsOfClass, LampsEndThem) {
  EXPECT_EQ(chains_of_class({"lamps_in_mirrors", "ER"}), (Chains{"RL"}));
  EXPECT_EQ(chains_of_class({"lamps", "E(T|TT)"}), (Chains{"TL", "TTL"}));
  EXPECT_EQ(chains_of_class({"emission", "E"}), Chains());
  EXPECT_EQ(chains_of_class({"all_in_mirrors", "ER.{0,1}"}), (Chains{"RD", "RRL", "RTL"}))
      << "after R, light of lamps and what D scatters";
}

TEST(ChainsOfClass, LongOnesAreThoseWithLayers) {
  const PathClass lamps{"lamps", "E[RT]+"};
  const Chains few = chains_of_class(lamps);
  EXPECT_EQ(few.size(), 14u) << "those of up to three events";
  EXPECT_EQ(few.back(), "TTTL");
  const Chains layers{"color", "chain.TTRTTD.motion.forward", "chain.RD.albedo", "chain.RRRRD.depth"};
  Chains more = few;
  more.insert(more.end(), {"RRRRL", "TTRTTL"});
  EXPECT_EQ(chains_of_class(lamps, layers), more);
}

}  // namespace
}  // namespace tempera
