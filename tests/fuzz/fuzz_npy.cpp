// Fuzz target of the .npy reader.
#include "fuzz/fuzz_reader.h"

extern "C" int LLVMFuzzerTestOneInput(const unsigned char* data, std::size_t size)
{
    return vdb_nns::readFuzzed(data, size, [](const vdb_nns::ArrayFile& file) {
        vdb_nns::NpyLayout layout;
        vdb_nns::ReadArray result;
        vdb_nns::parseNpy(file, layout, result);
    });
}
