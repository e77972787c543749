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
class SparseGrid;

/// Neighbor lists as compressed sparse rows: row i is indices[offsets[i]] to indices[offsets[i+1]], ascending.
struct Csr {
    std::vector<std::uint64_t> offsets; ///< size()+1 values
    std::vector<std::uint32_t> indices;
};

struct ListStatistics {
    std::uint64_t pairs = 0; ///< ordered pairs (query, neighbor)
    std::uint32_t min = 0;   ///< fewest neighbors of a particle
    double mean = 0;         ///< pairs / particles; 0 without particles
    std::uint32_t max = 0;
    std::uint64_t isolated = 0; ///< particles without a neighbor, non-finite ones included
};

/// The result of a search: for every particle its neighbors. Immutable; a cheap handle whose copies share the data,
/// which stays valid for as long as a handle lives, whatever the engine that made it does next. Safe to read from
/// several threads, and from inside of parallel work (search.h).
///
/// A particle's number i is below size(); it is not checked.
///
/// A list holds particle numbers of the ParticleView in cell-visiting order: by the neighbor's cell, (x, y, z)
/// lexicographic, and by number inside a cell; the same for both encodings. The particle itself is not in its list;
/// particles at the same place are.
class NeighborLists {
public:
    NeighborLists();
    explicit NeighborLists(std::shared_ptr<const NeighborListsData> data);

    std::size_t size() const; ///< particles, non-finite ones included
    Encoding encoding() const;
    std::uint64_t pairCount() const;
    const ListStatistics& statistics() const;

    /// Number of neighbors of particle i. Constant time.
    std::uint32_t count(std::size_t i) const;

    /// Counts of all particles, by number.
    std::vector<std::uint32_t> counts() const;

    /// The list of particle i where it is stored as numbers: a view of the lists' own memory, valid for as long as a
    /// handle of these lists lives.
    /// @throws InvalidInput unless encoding() is kIndex
    Span<const std::uint32_t> indices(std::size_t i) const;

    /// The list of particle i in either encoding, placed into `out` (which is resized).
    /// With masks, the first call makes a directory of 8 bytes an occupied cell.
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

    /// Hands every particle of the grid its list, in storage order split over the caller's TBB arena: `visit` is called
    /// from several threads at once, once for each finite particle; the numbers are valid during the call. The fastest way
    /// to read all lists.
    /// @throws InvalidInput with encoding kNone, and what `visit` throws
    void visitRows(const RowVisitor& visit) const;

    /// All lists sorted ascending. Cost: the copy and a sort of every row. Memory: 4 bytes a pair and 8 a particle beside
    /// these lists, and 4 more a particle while it is made; no option bounds it.
    /// @throws InvalidInput with encoding kNone; Cancelled; std::bad_alloc
    Csr toCsr(Progress* progress = nullptr) const;

    /// Sum over ordered pairs (i, j) of mix64(i * 2^32 + j) modulo 2^64, mix64 the finaliser of SplitMix64
    /// (Steele, Lea, Flood 2014): equal for equal sets of pairs, whatever the order.
    /// @throws InvalidInput with encoding kNone; Cancelled
    std::uint64_t checksum(Progress* progress = nullptr) const;

    /// Bytes of the lists themselves: indices or masks, offsets and counts.
    std::uint64_t bytes() const;

    /// The particles and the grid that the lists were made from.
    const ParticleView& view() const;
    const SparseGrid& grid() const;
    double radius() const; ///< of the search that made them, in world units; at most grid().radius()

    const NeighborListsData& data() const { return *mData; }

private:
    std::shared_ptr<const NeighborListsData> mData;
};

} // namespace vdb_nns
