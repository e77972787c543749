// Fuzz target of the .npy reader.
#include "fuzz/fuzz_reader.h"

extern "C" int LLVMFuzzerTestOneInput(const unsigned char* data, std::size_t size)
{
    vdb_nns::readFuzzed(data, size, [](const vdb_nns::ArrayFile& file) {
        for (std::uint64_t count = 0; count < 8; ++count) {
            try {
                vdb_nns::parseNpyValues(file, count);
            } catch (const vdb_nns::InputError&) { // of another length
            }
            const vdb_nns::StoredValue value = vdb_nns::describeNpyValues(file.path, "a", file.bytes, count);
            vdb_nns::PointValues values;
            if (value.problem.empty()) vdb_nns::readNpyValues(file, value, count, values);
        }
    });
    return vdb_nns::readFuzzed(data, size, [](const vdb_nns::ArrayFile& file) {
        vdb_nns::NpyLayout layout;
        vdb_nns::ReadArray result;
        vdb_nns::parseNpy(file, layout, result);
    });
}
