// One picture by OpenSplat's CPU path. It calls that program's public functions alone, and is
// compiled with the user's copy of its sources (opensplat_peer.py), none of which are here.
#include <torch/extension.h>

#include "project_gaussians.hpp"
#include "rasterize_gaussians.hpp"
#include "spherical_harmonics.hpp"

torch::Tensor render(torch::Tensor means, torch::Tensor quats, torch::Tensor scales,
                     torch::Tensor opacities, torch::Tensor sh, torch::Tensor directions,
                     torch::Tensor view, torch::Tensor projection, torch::Tensor background,
                     double fx, double fy, double cx, double cy, int64_t width, int64_t height) {
    auto seen = ProjectGaussiansCPU::apply(means, scales, 1, quats, view, projection, fx, fy, cx,
                                           cy, height, width);
    auto colors = SphericalHarmonicsCPU::apply(degFromSh(sh.size(1)), directions, sh);
    // Its sort reads the depths as if they lay side by side; they come as every third number.
    auto depths = seen[4].contiguous();
    return RasterizeGaussiansCPU::apply(seen[0], seen[1], seen[2], torch::clamp_min(colors + 0.5, 0),
                                        opacities, seen[3], depths, height, width, background);
}

PYBIND11_MODULE(TORCH_EXTENSION_NAME, module) { module.def("render", &render); }
