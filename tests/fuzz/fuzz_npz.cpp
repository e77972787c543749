// Fuzz target of the .npz reader.
#include "fuzz/fuzz_reader.h"

extern "C" int LLVMFuzzerTestOneInput(const unsigned char* data, std::size_t size)
{
    return vdb_nns::readFuzzed(data, size, vdb_nns::parseNpz);
}
