// Fuzz target of the .ply reader.
#include "fuzz/fuzz_reader.h"

extern "C" int LLVMFuzzerTestOneInput(const unsigned char* data, std::size_t size)
{
    return vdb_nns::readFuzzed(data, size, [](const vdb_nns::ArrayFile& file) {
        if (file.choice.columns.empty()) vdb_nns::parsePly(file); // a choice changes nothing
    });
}
