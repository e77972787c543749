// Fuzz target of the .vdb reader: any bytes are point grids or an error of ours, whose points and attributes can be read and are
// what their sizes say, in memory that the file's size justifies.
#include "io/vdb/archive.h"
#include "io/vdb/grid_header.h"
#include "io/vdb/point_layout.h"
#include "io/vdb/point_reader.h"
#include "io/vdb_file.h"
#include "support/memory_bytes.h"
#include "vdb_nns/error.h"

#include <oneapi/tbb/task_arena.h>

#include <algorithm>
#include <atomic>
#include <cstdio>
#include <cstdlib>
#include <new>
#include <set>
#include <string>

#include <malloc.h>

namespace {

// What operator new has given out, and the most since it was set.
std::atomic<std::uint64_t> gHeapBytes{0}, gMostHeapBytes{0};

void* allocate(std::size_t bytes)
{
    void* const memory = std::malloc(bytes);
    if (!memory) throw std::bad_alloc();
    const std::uint64_t now = gHeapBytes += ::malloc_usable_size(memory);
    std::uint64_t most = gMostHeapBytes;
    while (now > most && !gMostHeapBytes.compare_exchange_weak(most, now)) {
    }
    return memory;
}

void release(void* memory)
{
    if (memory) gHeapBytes -= ::malloc_usable_size(memory);
    std::free(memory);
}

} // namespace

// All of them: what one of these gives out, another takes back.
void* operator new(std::size_t bytes)
{
    return allocate(bytes);
}
void* operator new[](std::size_t bytes)
{
    return allocate(bytes);
}
void* operator new(std::size_t bytes, const std::nothrow_t&) noexcept
{
    return allocate(bytes);
}
void* operator new[](std::size_t bytes, const std::nothrow_t&) noexcept
{
    return allocate(bytes);
}
void operator delete(void* memory) noexcept
{
    release(memory);
}
void operator delete[](void* memory) noexcept
{
    release(memory);
}
void operator delete(void* memory, std::size_t) noexcept
{
    release(memory);
}
void operator delete[](void* memory, std::size_t) noexcept
{
    release(memory);
}

namespace vdb_nns {

namespace {

const CancelCheck kNoCancel(nullptr, "fuzz");

void require(bool holds, const char* what)
{
    if (holds) return;
    std::fprintf(stderr, "fuzz_vdb: %s\n", what);
    std::abort();
}

void checkPoints(const GridPoints& points)
{
    require(points.starts.size() == points.leaves.size() + 1, "a start for each leaf");
    require(points.voxels.size() == points.size() && points.positions.size() == 3 * points.size(),
            "a voxel and a position for each point");
    for (std::size_t leaf = 0; leaf < points.leaves.size(); ++leaf) {
        require(points.starts[leaf] < points.starts[leaf + 1], "points in each leaf");
        require(leaf == 0 || points.leaves[leaf - 1] != points.leaves[leaf], "leaves at different places");
        for (std::uint64_t i = points.starts[leaf]; i < points.starts[leaf + 1]; ++i) {
            const std::uint16_t voxel = points.voxels[i];
            require(voxel < 512, "a voxel of the leaf");
            require(i == points.starts[leaf] || points.voxels[i - 1] <= voxel, "voxels that ascend");
        }
    }
}

void readAttributes(const VdbPointReader& reader, const VdbPointLayout& layout, const GridPoints& points,
                    std::uint64_t allowedBytes)
{
    std::set<std::string> names;
    std::size_t mostBytes = 0;
    for (const VdbDescriptor& descriptor : layout.descriptors) {
        for (const VdbDescriptor::Attribute& attribute : descriptor.attributes) {
            names.insert(attribute.name);
            if (attribute.type.isKnown) mostBytes = std::max(mostBytes, attribute.type.bytes());
        }
    }
    std::size_t left = 20; // of a file with thousands they are all alike
    for (const std::string& name : names) {
        if (points.size() * mostBytes > allowedBytes || left-- == 0) return;
        try {
            const VdbValues values = reader.readAttribute({0, layout.leaves.size()}, name, points, kNoCancel);
            require(values.count == points.size(), "a value for each point");
        } catch (const InputError&) {
        }
    }
}

void readGrid(const ByteSource& file, const VdbDirectory& directory, const VdbEntry& entry,
              std::uint64_t allowedBytes)
{
    const VdbEntry* const parent = parentOf(file, directory, entry);
    const VdbEntry& tree = parent ? *parent : entry;
    if (tree.gridType != kVdbPointGridType) return;
    VdbCursor cursor(file, tree.gridBegin, tree.gridEnd);
    cursor.setPart(gridText(tree.uniqueName));
    const VdbPointLayout layout = readPointLayout(cursor, readGridHeader(cursor).compression);
    const VdbPointReader reader(file, layout, gridText(tree.uniqueName));
    const std::size_t leaves = layout.leaves.size();
    if (reader.pointBytes({0, leaves}) > allowedBytes) return;
    GridPoints points;
    reader.readPoints({0, leaves}, kNoCancel, points);
    checkPoints(points);
    readAttributes(reader, layout, points, allowedBytes);
    GridPoints part;
    reader.readPoints({leaves / 3, leaves - leaves / 4}, kNoCancel, part);
    checkPoints(part);
}

void readNamedValues(const ByteSource& file, const VdbFile& vdb, const PointFileInfo& info,
                     std::uint64_t allowedBytes)
{
    const std::size_t points = vdb.view().size();
    for (std::size_t i = 0; i < info.attributes.size() && i < 8; ++i) {
        try {
            require(vdb.readScalars(file, info.attributes[i].name, allowedBytes, kNoCancel).size() == points,
                    "a scalar for each point");
        } catch (const InputError&) { // is of another type
        }
    }
    for (std::size_t i = 0; i < info.groups.size() && i < 8; ++i) {
        if (info.groups[i].find_first_of(", \t^") != std::string::npos || info.groups[i].empty()) continue;
        require(vdb.readGroups(file, "^" + info.groups[i], allowedBytes, kNoCancel).size() == points,
                "a choice for each point");
    }
}

void readFile(const ByteSource& file, std::uint64_t allowedBytes)
{
    try {
        PointFileInfo info;
        const VdbFile vdb(file, "", {}, allowedBytes, kNoCancel, info);
        readNamedValues(file, vdb, info, allowedBytes);
        const VdbFile tile(file, "", TileOfFile{2, 3, 1.0}, allowedBytes, kNoCancel, info);
        require(tile.tileNumbers()->total == vdb.view().size() &&
                    tile.tileNumbers()->numbers.size() == tile.view().size(),
                "a number for each point of a tile");
    } catch (const Error&) {
    }
    try {
        const VdbDirectory directory = readVdbDirectory(file);
        for (const VdbEntry& entry : directory.entries) {
            try {
                readGrid(file, directory, entry, allowedBytes);
            } catch (const InputError&) {
            }
        }
    } catch (const InputError&) {
    }
}

} // namespace

} // namespace vdb_nns

extern "C" int LLVMFuzzerTestOneInput(const unsigned char* data, std::size_t size)
{
    static tbb::task_arena oneThread(1);
    const vdb_nns::testing::MemoryBytes file(data, size);
    const std::uint64_t allowedBytes = 64 * std::uint64_t(size);
    const std::uint64_t before = gHeapBytes;
    gMostHeapBytes = before;
    oneThread.execute([&] { vdb_nns::readFile(file, allowedBytes); });
    // A page decompresses to at most 256 times its size. Of TBB's own memory a part is allocated late.
    const std::uint64_t justified = allowedBytes + 300 * std::uint64_t(size) + (std::uint64_t(1) << 20);
    vdb_nns::require(gMostHeapBytes - before <= justified, "memory that the file's size justifies");
    return 0;
}
