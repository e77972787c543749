// Fuzz target of the .ply reader.
#include "fuzz/fuzz_reader.h"

#include <cstdlib>

extern "C" int LLVMFuzzerTestOneInput(const unsigned char* data, std::size_t size)
{
    return vdb_nns::readFuzzed(data, size, [](const vdb_nns::ArrayFile& file) {
        if (!file.choice.columns.empty()) return; // a choice changes nothing
        const vdb_nns::ReadArray read = vdb_nns::parsePly(file);
        for (std::size_t i = 0; i < read.properties.size() && i < 8; ++i) {
            try {
                const std::size_t values = vdb_nns::parsePlyProperty(file, read.properties[i].name).size();
                if (values != read.positions.size()) std::abort();
            } catch (const vdb_nns::InputError&) { // is a list, or there twice, or no text of its type
            }
        }
    });
}
