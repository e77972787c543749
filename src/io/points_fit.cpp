#include "io/array_readers.h"
#include "vdb_nns/error.h"

#include <string>

namespace vdb_nns {

void checkPointsFit(const std::string& path, std::uint64_t neededBytes, std::uint64_t allowedBytes)
{
    if (neededBytes <= allowedBytes) return;
    throw CapacityError(path + ": its points alone need " + std::to_string(neededBytes) +
                            " bytes of memory to be read, allowed are " + std::to_string(allowedBytes) +
                            ": split the file, or let it have more memory",
                        neededBytes, allowedBytes);
}

} // namespace vdb_nns
