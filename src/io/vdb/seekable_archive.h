// Writes grids with OpenVDB to a stream of our own. For sources that include OpenVDB anyway.
#pragma once

#include <openvdb/io/Archive.h>

#include <ostream>

namespace vdb_nns {

// OpenVDB's io::File writes to paths only and does not notice a full disk, and its io::Stream leaves out the offsets that
// io::File wants to read.
class SeekableArchive final : public openvdb::io::Archive {
public:
    void writeTo(std::ostream& out, const openvdb::GridCPtrVec& grids,
                 const openvdb::MetaMap& metadata = {}) const
    {
        write(out, grids, /*seekable=*/true, metadata);
    }

private:
    using openvdb::io::Archive::write;
};

} // namespace vdb_nns
