// Result attributes of a grid, for those who may be stopped.
#pragma once

#include "util/cancel.h"
#include "vdb_nns/openvdb_bridge.h"

#include <cstdint>
#include <string>

namespace vdb_nns {

// As that of openvdb_bridge.h, and throws Cancelled.
void setPointAttribute(openvdb::points::PointDataGrid& grid, const std::string& name,
                       Span<const std::uint32_t> values, bool overwrite, const CancelCheck& cancel);

} // namespace vdb_nns
