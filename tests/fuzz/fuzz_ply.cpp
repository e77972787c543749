// Fuzz target of the .ply reader: any bytes are positions or an InputError, and nothing else.
#include "io/array_readers.h"
#include "vdb_nns/error.h"

extern "C" int LLVMFuzzerTestOneInput(const unsigned char* data, std::size_t size)
{
    try {
        vdb_nns::parsePly("fuzz.ply", {data, size});
    } catch (const vdb_nns::InputError&) {
    }
    return 0;
}
