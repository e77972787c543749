// Where the parts of one grid of a .vdb file lie, and what its header says: for those who read its points or their values.
#pragma once

#include "io/byte_source.h"
#include "io/vdb/archive.h"
#include "io/vdb/grid_header.h"
#include "io/vdb/point_layout.h"

#include <string>
#include <vector>

namespace vdb_nns {

struct VdbGridLayout {
    VdbGridHeader header;
    VdbPointLayout layout;
};

// Of a point grid with an affine transform. Throws InputError.
VdbGridLayout readVdbGridLayout(const ByteSource& file, const VdbDirectory& directory, const VdbEntry& entry);

// Of the point groups of all leaves, sorted.
std::vector<std::string> vdbGroupNames(const VdbPointLayout& layout);

} // namespace vdb_nns
