// A plan as a picture.
#pragma once

#include "report.h"
#include "vdb_nns/sparse_grid.h"

#include <string>

namespace vdb_nns::cli {

/// The blocks of a plan, seen along the axis on which the scene is shortest, coloured by who would run them. A whole SVG
/// file, under 2 MB: of more than 20000 blocks those with the least work are left out, and the picture says how many.
/// @param scene what the picture shows, for its title
std::string planSvg(const SparseGrid& grid, const Plan& plan, const std::string& scene);

} // namespace vdb_nns::cli
