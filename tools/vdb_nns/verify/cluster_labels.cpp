#include "cluster_labels.h"

#include "row_pass.h"

#include <limits>
#include <mutex>
#include <numeric>
#include <utility>

namespace vdb_nns::cli {

namespace {

using Number = std::uint32_t;
constexpr Number kNone = std::numeric_limits<Number>::max(); // a view has fewer points

// Sets of numbers, each known by its smallest.
class Components {
public:
    explicit Components(std::size_t count) : mParents(count)
    {
        std::iota(mParents.begin(), mParents.end(), Number(0));
    }

    Number smallest(Number i)
    {
        while (mParents[i] != i) i = mParents[i] = mParents[mParents[i]];
        return i;
    }

    void join(Number a, Number b)
    {
        a = smallest(a);
        b = smallest(b);
        mParents[std::max(a, b)] = std::min(a, b);
    }

private:
    std::vector<Number> mParents;
};

// What the passes share. Pairs come in pieces under the lock.
struct Graph {
    explicit Graph(std::size_t count) : components(count), smallestCore(count, kNone) {}

    std::mutex mutex;
    std::vector<std::uint8_t> isCore;
    Components components;
    std::vector<Number> smallestCore; // of the pairs of a point

    void add(Number i, const std::vector<Number>& within)
    {
        for (const Number j : within) {
            if (isCore[i] && isCore[j]) components.join(i, j);
            if (isCore[j]) smallestCore[i] = std::min(smallestCore[i], j);
            if (isCore[i]) smallestCore[j] = std::min(smallestCore[j], i);
        }
    }
};

// Marks the cores.
class CoreMarker {
public:
    CoreMarker(Graph& graph, std::uint32_t minNeighbors) : mGraph(&graph), mMinNeighbors(minNeighbors) {}

    void check(Number query, const std::vector<Number>& within)
    {
        mGraph->isCore[query] = within.size() >= mMinNeighbors; // a byte of its own
    }
    void merge(const CoreMarker&) {}
    void countExactPairs(std::uint64_t) {}

private:
    Graph* mGraph;
    std::uint32_t mMinNeighbors;
};

// Adds the pairs.
class PairAdder {
public:
    explicit PairAdder(Graph& graph) : mGraph(&graph) {}

    void check(Number query, const std::vector<Number>& within)
    {
        if (within.empty()) return;
        const std::lock_guard<std::mutex> lock(mGraph->mutex);
        mGraph->add(query, within);
    }
    void merge(const PairAdder&) {}
    void countExactPairs(std::uint64_t) {}

private:
    Graph* mGraph;
};

// Clusters in the order of their smallest core, which comes first among the cores.
ClusterLabels labelsOf(const SearchJudge& judge, Graph& graph)
{
    const std::size_t count = graph.isCore.size();
    ClusterLabels result;
    result.labels.assign(count, -1);
    result.sizes.assign(count, 0);
    std::vector<std::int64_t> sizes;
    for (Number i = 0; i < count; ++i) {
        if (!graph.isCore[i] || !judge.isFiniteQuery(i)) continue;
        const Number root = graph.components.smallest(i);
        if (root == i) {
            result.labels[i] = static_cast<std::int64_t>(sizes.size());
            sizes.push_back(0);
        }
        result.labels[i] = result.labels[root];
    }
    for (Number i = 0; i < count; ++i) {
        if (!graph.isCore[i] && graph.smallestCore[i] != kNone)
            result.labels[i] = result.labels[graph.smallestCore[i]];
        if (result.labels[i] >= 0) ++sizes[static_cast<std::size_t>(result.labels[i])];
    }
    for (Number i = 0; i < count; ++i) {
        if (result.labels[i] >= 0) result.sizes[i] = sizes[static_cast<std::size_t>(result.labels[i])];
    }
    return result;
}

} // namespace

ClusterLabels findClusters(const SearchJudge& judge, const std::optional<std::uint32_t>& minNeighbors,
                           Progress* progress, double from, double to)
{
    const std::size_t count = judge.queryCount();
    Graph graph(count);
    graph.isCore.assign(count, 1);
    double middle = from;
    if (minNeighbors) {
        middle = (from + to) / 2;
        RowPass<CoreMarker>(judge, CoreMarker(graph, *minNeighbors)).run({}, {progress, from, middle});
    }
    RowPass<PairAdder>(judge, PairAdder(graph)).run({}, {progress, middle, to});
    return labelsOf(judge, graph);
}

} // namespace vdb_nns::cli
