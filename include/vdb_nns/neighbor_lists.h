// Neighbor lists in memory: two encodings, one way to read them.
#pragma once

#include "vdb_nns/progress.h"
#include "vdb_nns/search_options.h"
#include "vdb_nns/types.h"

#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

namespace vdb_nns {

struct NeighborListsData; // src/lists/neighbor_lists_data.h
class ParticleView;
class SearchSets;
class SparseGrid;

/// Neighbor lists as compressed sparse rows: row i is indices[offsets[i]] to indices[offsets[i+1]],
/// ascending.
struct Csr {
    std::vector<std::uint64_t> offsets; ///< size()+1 values
    std::vector<std::uint32_t> indices;
};

/// Over the finite queries. A query in its own list is a pair, and else counts nowhere.
struct ListStatistics {
    std::uint64_t pairs = 0;     ///< ordered pairs (query, neighbor)
    std::uint32_t min = 0;       ///< fewest neighbors of a query
    double mean = 0;             ///< of the neighbors of a query; 0 without queries
    std::uint32_t max = 0;       ///< most neighbors of a query
    std::uint64_t isolated = 0;  ///< queries without a neighbor
    std::uint64_t shortened = 0; ///< queries that had more neighbors than the nearest that were asked for
};

/// The result of a search: the neighbors of every particle. Immutable; a cheap handle whose copies share the
/// data. The data stays valid while any handle lives, whatever the engine that made it does next; arrays that the
/// caller gave to the search (positions, chosen particles, radii) must live as long. Safe to
/// read from several threads, and from inside parallel work (search.h).
///
/// The number i of a query must be below size(); that is not checked.
///
/// A list holds numbers of the candidates' view in cell-visiting order: by the neighbor's cell, (x, y,
/// z) lexicographic, and by number inside a cell; on several lattices (SearchSets) one after the other. The order is the same for both encodings. Unless asked for
/// (SearchOptions::includeSelf), a particle is not in its own list; others at the same place are.
class NeighborLists {
public:
    NeighborLists();
    explicit NeighborLists(std::shared_ptr<const NeighborListsData> data);

    std::size_t size() const; ///< particles of the queries' view: queries or not, finite or not
    Encoding encoding() const;
    std::uint64_t pairCount() const;
    const ListStatistics& statistics() const;

    /// Number of neighbors of query i, itself not included. Constant time.
    std::uint32_t count(std::size_t i) const;

    /// count() of all, by number.
    std::vector<std::uint32_t> counts() const;

    /// The list of particle i, if lists are stored as numbers: a view of their own memory, valid while a
    /// handle of these lists lives. Constant time.
    /// @throws InvalidInput unless encoding() is kIndex
    Span<const std::uint32_t> indices(std::size_t i) const;

    /// Writes the list of particle i, in either encoding, to `out`, which is resized. With masks, the first
    /// call makes a directory of 8 bytes for each occupied cell.
    /// @throws InvalidInput with encoding kNone
    void neighbors(std::size_t i, std::vector<std::uint32_t>& out) const;

    /// Calls f(std::uint32_t neighbor) for each neighbor of particle i, in either encoding.
    /// @throws InvalidInput with encoding kNone
    template <typename F>
    void forEachNeighbor(std::size_t i, F&& f) const
    {
        if (encoding() == Encoding::kIndex) {
            for (const std::uint32_t neighbor : indices(i)) f(neighbor);
        } else {
            std::vector<std::uint32_t> list;
            neighbors(i, list);
            for (const std::uint32_t neighbor : list) f(neighbor);
        }
    }

    using RowVisitor = std::function<void(std::uint32_t query, Span<const std::uint32_t> neighbors)>;

    /// Calls `visit` once for every query that is finite and near any candidate, with its list: the fastest way to read all lists. The
    /// work is split in storage order over the caller's TBB arena, so `visit` is called from several threads
    /// at once. The span is valid during the call.
    /// @throws InvalidInput with encoding kNone, and whatever `visit` throws
    void visitRows(const RowVisitor& visit) const;

    /// All lists, each sorted ascending. Cost: the copy and a sort of every row. Memory: 4 bytes a pair and 8
    /// a particle beside these lists, and 4 more a particle while it runs; no option bounds it.
    /// @throws InvalidInput with encoding kNone; Cancelled; std::bad_alloc
    Csr toCsr(Progress* progress = nullptr) const;

    /// Sum over ordered pairs (i, j) of mix64(i * 2^32 + j) modulo 2^64, where mix64 is the finalizer of
    /// SplitMix64 (Steele, Lea, Flood 2014). Equal for equal sets of pairs, whatever their order.
    /// @throws InvalidInput with encoding kNone; Cancelled
    std::uint64_t checksum(Progress* progress = nullptr) const;

    /// Bytes of the lists themselves: indices or masks, offsets and counts.
    std::uint64_t bytes() const;

    /// What the lists were made from.
    const SearchSets& sets() const;
    const ParticleView& view() const; ///< of the candidates
    SparseGrid grid() const; ///< of the candidates; on several lattices, of those with the widest cells
    double radius() const;   ///< of the search that made them, the largest; world units

    const NeighborListsData& data() const { return *mData; }

private:
    std::shared_ptr<const NeighborListsData> mData;
};

} // namespace vdb_nns
