// Tiles: a search in parts that share nothing but files. Each part finds the rows of its own range of leaves and writes them to a
// file; the files together are the lists of one search, byte for byte.
#pragma once

#include "vdb_nns/neighbor_lists.h"
#include "vdb_nns/output.h"
#include "vdb_nns/particle_view.h"
#include "vdb_nns/point_file.h"
#include "vdb_nns/progress.h"

#include <cstdint>
#include <string>
#include <vector>

namespace vdb_nns {

/// A range of leaves, in the order of a VDB tree, whose particles are the queries of one part.
struct Tile {
    std::uint64_t firstLeaf = 0, endLeaf = 0;
    std::uint64_t particles = 0;
    std::uint64_t expectedPairs = 0;
    /// Particles of other tiles that may be within the radius: at most so many, by where their leaves are.
    std::uint64_t haloParticles = 0;
    /// Host memory that the search of the tile takes beside the particles, about: its grid and index lists, as expected.
    std::uint64_t bytes = 0;
};

/// Divides the particles of a view into tiles of about equal work, at leaves: those of a VDB grid are its own; those of an array
/// are of 8^3 cells of the radius. The work of a leaf is that of its particles and of the pairs that they would have if they were
/// spread evenly over the leaf, or over as many leaves as the radius spans: known without looking at a position of a grid. The tiles depend on the view, the radius and
/// their number alone.
/// Cost: a pass over the leaves; of an array a sort of its particles. Memory: 32 bytes a leaf; of an array 32 a particle while it is
/// sorted, then 4.
class TileCut {
public:
    /// @param radius world units, 0 or more and finite; where particles have their own, the largest
    /// @param tiles may be more than there are leaves: some are empty then
    /// @throws InvalidInput for a bad radius, and for no tile; Cancelled
    TileCut(const ParticleView& view, double radius, std::uint32_t tiles, Progress* progress = nullptr);

    const std::vector<Tile>& tiles() const { return mTiles; }

    /// Numbers of the particles of a tile, ascending.
    /// @param tile from 0
    std::vector<std::uint32_t> particles(std::uint32_t tile) const;

private:
    std::vector<Tile> mTiles;
    std::vector<std::uint64_t> mBegins;  // of the particles of each tile among all, and the end
    std::vector<std::uint32_t> mNumbers; // of the particles, leaf by leaf; empty: as they are numbered
};

/// What a part is of: parts go together if all but `tile` is equal.
struct PartOrigin {
    std::uint32_t tile = 0; ///< from 1
    std::uint32_t tiles = 0;
    std::uint64_t rows = 0;    ///< of all parts together
    std::uint64_t input = 0;   ///< stands for the files of the particles: hashFile()
    std::uint64_t options = 0; ///< stands for all else that makes the lists what they are
};

/// Writes some rows of lists as writeNpz() does, with the shape (rows, columns), and behind them two members more: `rows`
/// (int64), their numbers, and `part` (uint64[5]): tile, tiles, input, options, rows of all.
/// @param rows numbers of queries, ascending
/// @param numbers of a view of a tile alone (PointFile::tileNumbers()), so that the numbers written are those of the file; null:
///        they are those of the lists
/// @throws as writeNpz()
void writeNpzPart(const std::string& path, const NeighborLists& lists, const std::vector<std::uint32_t>& rows,
                  const PartOrigin& origin, const ListForm& form, const OutputOptions& options = {},
                  Progress* progress = nullptr, const TileNumbers* numbers = nullptr);

struct MergedParts {
    std::uint64_t rows = 0, columns = 0, pairs = 0;
};

/// Writes the file that one search would have written from the parts of all tiles, in any order. Every byte of a part is checked.
/// Cost: reads each part twice, all of which are open at once. Memory: 16 bytes a row; for each thread 64 MiB, or 8 KiB a part if that is
/// more.
/// @throws InputError for a file that is no part, or a damaged one; for parts of different searches; for a part that is missing or
///         there twice, with its number; OutputExists, OutputError, Cancelled
MergedParts mergeNpzParts(const std::vector<std::string>& parts, const std::string& path,
                          const OutputOptions& options = {}, Progress* progress = nullptr);

/// A number that stands for the bytes of a file: the same for the same bytes, and for others most probably another one.
/// Cost: reads the file.
/// @throws InputError, Cancelled
std::uint64_t hashFile(const std::string& path, Progress* progress = nullptr);

} // namespace vdb_nns
