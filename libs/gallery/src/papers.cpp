// SPDX-License-Identifier: Apache-2.0
#include "papers.h"

namespace tempera {

const GalleryPaper kManzi2016{"Manzi et al. 2016",
                              "Temporal Gradient-Domain Path Tracing. ACM Transactions on Graphics 35(6), 2016"};
const GalleryPaper kSchjoth2010{"Schjøth et al. 2010",
                                "Temporal Photon Differentials. International Conference on Computer Graphics Theory "
                                "and Applications, 2010"};
const GalleryPaper kWoestijne2017{"Van de Woestijne et al. 2017",
                                  "Temporal Coherence for Metropolis Light Transport. Eurographics Symposium on "
                                  "Rendering: Experimental Ideas & Implementations, 2017"};
const GalleryPaper kZhou2015{"Zhou and Chen 2015",
                             "Variance Reduction Using Interframe Coherence for Animated Scenes. Computational Visual "
                             "Media 1(4), 2015"};
const GalleryPaper kZimmer2015{"Zimmer et al. 2015",
                               "Path-space Motion Estimation and Decomposition for Robust Animation Filtering. "
                               "Computer Graphics Forum 34(4), 2015"};

}  // namespace tempera
