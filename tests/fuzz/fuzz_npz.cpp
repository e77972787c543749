// Fuzz target of the .npz reader.
#include "fuzz/fuzz_reader.h"

#include <vector>

extern "C" int LLVMFuzzerTestOneInput(const unsigned char* data, std::size_t size)
{
    vdb_nns::readFuzzed(data, size, [](const vdb_nns::ArrayFile& file) {
        std::vector<vdb_nns::StoredValue> wanted;
        for (const vdb_nns::StoredValue& value : vdb_nns::listNpzArrays(file, 2)) {
            if (value.problem.empty()) wanted.push_back(value);
        }
        vdb_nns::readNpzArrays(file, wanted, 2);
    });
    return vdb_nns::readFuzzed(data, size, vdb_nns::parseNpz);
}
