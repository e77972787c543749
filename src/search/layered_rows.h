// Rows of queries whose candidates are on several lattices: each lattice's share of a few rows is made in the cache, by the kernels
// for one, and the shares of a row then go one behind the other to where rows of the task go. The widest cells are last.
#pragma once

#include "cpu/kernels.h"
#include "cpu/search_task.h"
#include "exact/distance_order.h"
#include "grid/search_sets_data.h"
#include "util/memory.h"

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

namespace vdb_nns {

struct SearchRun;
struct ThreadState;

// What is made of a task's rows.
enum class RowKind {
    kIndex,   // rows of numbers, held for long
    kVisit,   // rows of numbers, read at once
    kSmaller, // the same, of numbers smaller than the query's
    kHalf,    // the same as kVisit, or each pair of a leaf once: RowSink::areHalf
    kMask,
    kCount
};

// The candidates of a run on one lattice.
struct LayerRun {
    const SparseGridData* candidates;
    int octaves; // SearchLayer::octaves
    SearchContext context;
};

// A task among the candidates of one layer.
struct LayerTask {
    SearchTask task;
    LeafNeighborhood neighborhood;
    WidePlace place;

    LayerTask() = default;
    LayerTask(const LayerTask&) = delete; // the task points into it
    LayerTask& operator=(const LayerTask&) = delete;
};

// Makes `layerTask` for a layer of wider cells. False where no candidate of the layer is in reach.
bool findLayerTask(const SparseGridData& queries, const SparseGridData& candidates, int octaves,
                   const SearchTask& task, LayerTask& layerTask);

// What one thread needs to make such rows.
class LayeredRows {
public:
    // Of the shares of a thread, beside what two rows may take.
    static constexpr std::size_t kMostBytes = std::size_t(4) << 20;

    // The rows of `task`, to `sink`; statistics are added to those of `state`. Throws what the sink's grow() throws.
    void make(const SearchRun& run, RowKind kind, const SearchTask& task, ThreadState& state, RowSink& sink);

private:
    // The share of one layer.
    struct Share {
        RowSink sink{};
        LayeredRows* owner = nullptr;
        std::vector<PageBlock> blocks;
        std::size_t blocksUsed = 0;
        std::vector<std::uint32_t*> begin; // of each row; of masks the first
        std::vector<std::uint32_t> count;
        bool isEmpty = true; // no candidate in reach
    };
    // The shares of these rows take too much memory.
    struct Full {};

    static void grow(RowSink& sink, std::size_t entries);
    void growShare(Share& share, std::size_t entries);
    void beginShare(Share& share, const SearchTask& task);
    void makeShares(const SearchRun& run, RowKind kind, const SearchTask& task, ThreadState& state);
    void addCounts(const SearchTask& task, RowSink& sink) const;
    void joinMasks(const SearchRun& run, const SearchTask& task, RowSink& sink);
    void joinNumbers(const SearchRun& run, const SearchTask& task, ThreadState& state, RowSink& sink);
    // Of the numbers in mRow, the nearest, in the same order, and the query if it is to stand there.
    void keepNearest(const SearchRun& run, std::uint32_t query, ThreadState& state);

    std::vector<std::unique_ptr<Share>> mShares; // of the layers
    std::size_t mBytes = 0;                      // of the blocks that the shares use
    bool mMayBeFull = false;                     // as long as fewer rows can be made at once
    std::uint32_t mMostRows = 1u << 16;          // that are made at once
    std::vector<std::uint32_t> mRow, mBeforeSelf;
    std::optional<DistanceOrder> mOrder;
    const ExactTest* mOrderedBy = nullptr; // what mOrder asks
};

} // namespace vdb_nns
