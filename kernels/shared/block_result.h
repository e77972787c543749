// What a device hands back of a block, in the order of memory. Any compiler.
//
//   head | leafRows [u64] | counts [u32] | rows [u32] | undecided [UndecidedPair, aligned to 16] ... | scratch
//
// leafRows (masks only): where the rows of each own leaf begin, in words.  counts: neighbors of each query.  rows: in the
// order of the queries, without padding. Cells that are not wanted have counts of 0 and no rows. Undecided pairs lie in the
// error band of the filter: they are counted, and stand in the rows, as neighbors until the host has decided.
// The scratch is the device's own and stands at the end of the room; it is not downloaded.
#pragma once

#include "shared/annotation.h"
#include "vdb_nns/search_options.h"

#include <cstdint>

namespace vdb_nns {

struct ResultHead {
    std::uint64_t rowBytes;              // of all rows, those that found no room included
    std::uint64_t undecided;             // pairs, those that found no room included
    std::uint64_t bandPairs, exactPairs; // pairs that the device has decided by the slower tests
};

struct UndecidedPair {
    std::uint32_t query;     // counted from the first one of the block
    std::uint32_t candidate; // its number
    std::uint64_t bit;       // of all rows, masks only
};

// Where the parts of a result stand, in bytes from its begin.
struct ResultLayout {
    std::uint64_t leafRows, counts, rows;
    VDB_NNS_HOST_DEVICE std::uint64_t undecided(std::uint64_t rowBytes) const
    {
        return (rows + rowBytes + 15) / 16 * 16;
    }
    VDB_NNS_HOST_DEVICE std::uint64_t end(const ResultHead& head) const
    {
        return head.undecided == 0 ? rows + head.rowBytes
                                   : undecided(head.rowBytes) + head.undecided * sizeof(UndecidedPair);
    }
};

static inline ResultLayout resultLayout(std::uint64_t leaves, std::uint64_t queries, Encoding encoding)
{
    ResultLayout layout{};
    // 64-bit words first, so that they are aligned.
    layout.leafRows = sizeof(ResultHead);
    layout.counts = layout.leafRows + (encoding == Encoding::kMask ? leaves * 8 : 0);
    layout.rows = layout.counts + queries * 4;
    return layout;
}

// Room for undecided pairs that a block is given: one for 64 queries, and some. About one test in 10^5 is undecided, one
// query in some hundreds; a lattice has more, and its blocks are redone in parts.
static inline std::uint64_t undecidedRoom(std::uint64_t queries)
{
    return 256 + queries / 4;
}

// Queries are searched in groups, one to a warp. Rows of the groups before are added up in tiles of groups.
constexpr std::uint32_t kGroupQueries = 32, kTileGroups = 1024;

struct GroupCounts {
    std::uint64_t groups, tiles;
};
static inline GroupCounts groupCounts(std::uint64_t queries)
{
    const std::uint64_t groups = (queries + kGroupQueries - 1) / kGroupQueries;
    return {groups, (groups + kTileGroups - 1) / kTileGroups};
}

// A 64-bit word of each group and tile, and the sum; and what aligning them may take.
static inline std::uint64_t scratchBytes(std::uint64_t queries, Encoding encoding)
{
    if (encoding == Encoding::kNone) return 0;
    const GroupCounts counts = groupCounts(queries);
    return (counts.groups + counts.tiles + 1) * 8 + 8;
}

// What is left of the room of a result for all but the scratch.
static inline std::uint64_t resultRoom(std::uint64_t bytes, std::uint64_t queries, Encoding encoding)
{
    const std::uint64_t scratch = scratchBytes(queries, encoding);
    return bytes > scratch ? (bytes - scratch) / 8 * 8 : 0;
}

} // namespace vdb_nns
