// What reading a file takes with OpenVDB.
#include "bench/methods/peers.h"
#include "machine.h"

#include <openvdb/openvdb.h>

namespace vdb_nns::cli {

double timeOpenVdbRead(const std::string& path)
{
    openvdb::initialize();
    const Stopwatch watch;
    openvdb::io::File file(path);
    file.open(/*delayLoad=*/false); // which would copy the file first
    openvdb::GridPtrVecPtr grids = file.getGrids();
    return watch.seconds();
}

} // namespace vdb_nns::cli
