// What the fuzz targets of array readers have in common: any bytes are positions or an InputError, and nothing else.
#pragma once

#include "io/array_readers.h"
#include "vdb_nns/error.h"

namespace vdb_nns {

template <typename Read>
int readFuzzed(const unsigned char* data, std::size_t size, Read&& read)
{
    const CancelCheck cancel(nullptr, "read");
    const std::string path = "fuzz";
    const ArrayChoice choices[] = {{}, {{0, 1, 2}, {}}, {{2, 0, 5}, "a"}};
    for (const ArrayChoice& choice : choices) {
        try {
            read(ArrayFile{path, {data, size}, choice, 100 * size + 4096, cancel});
        } catch (const InputError&) {
        } catch (const InvalidInput&) { // of choices that the file does not have
        } catch (const CapacityError&) {
        }
    }
    return 0;
}

} // namespace vdb_nns
