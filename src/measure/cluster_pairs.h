// Clusters of the pairs of a pass: connected components, or those of core points (DBSCAN) with what is near them. The same for any
// order of the pairs.
#pragma once

#include "measure/chunks.h"
#include "measure/components.h"
#include "measure/results.h"
#include "util/cancel.h"
#include "util/memory.h"
#include "vdb_nns/neighbor_lists.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <new>
#include <optional>
#include <utility>
#include <vector>

namespace vdb_nns {

// Which particles are core points, and what the others are near to.
class CorePoints {
public:
    CorePoints(const NeighborLists& counts, std::uint32_t minNeighbors, const CancelCheck& cancel)
        : mIsCore(counts.size()), mNearest(counts.size() * sizeof(Number))
    {
        Number* const nearest = static_cast<Number*>(mNearest.data());
        forEachChunk(counts.size(), cancel, [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i < end; ++i) {
                mIsCore[i] = counts.count(i) >= minNeighbors;
                new (nearest + i) Number(kNone);
            }
        });
    }

    static constexpr std::uint32_t kNone = 0xffffffffu;

    bool isCore(std::uint32_t i) const { return mIsCore[i] != 0; }
    // The core point of the smallest number that is a neighbor of a border point, or has it as one.
    std::uint32_t coreNear(std::uint32_t border) const
    {
        return static_cast<const Number*>(mNearest.data())[border].load(std::memory_order_relaxed);
    }
    void offer(std::uint32_t border, std::uint32_t core)
    {
        Number& least = static_cast<Number*>(mNearest.data())[border];
        std::uint32_t known = least.load(std::memory_order_relaxed);
        while (core < known && !least.compare_exchange_weak(known, core, std::memory_order_relaxed)) {
        }
    }

private:
    using Number = std::atomic<std::uint32_t>;
    std::vector<std::uint8_t> mIsCore;
    PageBlock mNearest;
};

// Takes the pairs of a pass, each in at least one direction.
class ClusterPairs {
public:
    // Takes 4 bytes a particle of each of the two memories, which outlive it.
    ClusterPairs(std::size_t particles, std::optional<CorePoints> cores, PageArray<char> (&memory)[2])
        : mComponents(particles, memory[0]), mRankMemory(memory[1]), mCores(std::move(cores))
    {
    }

    // A row that is filled up as Components wants it.
    void add(std::uint32_t query, const std::uint32_t* neighbors, std::uint32_t count)
    {
        if (!mCores) {
            mComponents.uniteRow(query, neighbors, count);
        } else if (mCores->isCore(query)) {
            std::uint32_t root = query;
            for (std::uint32_t k = 0; k < count; ++k) {
                if (mCores->isCore(neighbors[k])) {
                    root = mComponents.uniteKnown(root, neighbors[k]);
                } else {
                    mCores->offer(neighbors[k], query);
                }
            }
        } else {
            for (std::uint32_t k = 0; k < count; ++k) {
                if (mCores->isCore(neighbors[k])) mCores->offer(query, neighbors[k]);
            }
        }
    }

    // Writes labels and sizes. `inCluster(i)`: whether a particle can be in one at all.
    template <typename InCluster>
    void finish(const MeasureTargets& targets, std::size_t particles, const CancelCheck& cancel,
                InCluster&& inCluster)
    {
        // The root of a cluster is the smallest number in it, of core points if there are any: roots in order have the ranks.
        const auto isRoot = [&](std::size_t i) {
            const auto number = static_cast<std::uint32_t>(i);
            return mComponents.isRoot(number) && (!mCores || mCores->isCore(number)) && inCluster(i);
        };
        const std::size_t chunks = (particles + kMeasureChunk - 1) / kMeasureChunk;
        std::vector<std::uint32_t> rootsBefore(chunks + 1);
        const auto forEachChunkOfRoots = [&](auto&& f) {
            tbb::parallel_for(std::size_t(0), chunks, [&](std::size_t chunk) {
                cancel.check();
                const std::size_t end = std::min(particles, (chunk + 1) * kMeasureChunk);
                for (std::size_t i = chunk * kMeasureChunk; i < end; ++i) {
                    if (isRoot(i)) f(chunk, i);
                }
            });
        };
        forEachChunkOfRoots([&](std::size_t chunk, std::size_t) { ++rootsBefore[chunk + 1]; });
        for (std::size_t chunk = 0; chunk < chunks; ++chunk) rootsBefore[chunk + 1] += rootsBefore[chunk];
        mRankMemory.resizeDiscarding(particles * sizeof(std::uint32_t));
        auto* const rank = reinterpret_cast<std::uint32_t*>(mRankMemory.data());
        std::vector<std::uint32_t> next(rootsBefore);
        forEachChunkOfRoots([&](std::size_t chunk, std::size_t i) { rank[i] = next[chunk]++; });

        std::vector<std::atomic<std::uint32_t>> size(rootsBefore.back());
        const auto labelOf = [&](std::size_t i) {
            auto with = static_cast<std::uint32_t>(i);
            if (mCores && !mCores->isCore(with)) with = mCores->coreNear(with);
            return inCluster(i) && with != CorePoints::kNone ? rank[mComponents.find(with)]
                                                             : CorePoints::kNone;
        };
        forEachChunk(particles, cancel, [&](std::size_t begin, std::size_t end) {
            // Counted run by run, for most points are in a few clusters.
            std::uint32_t last = CorePoints::kNone, run = 0;
            const auto add = [&] {
                if (last != CorePoints::kNone) size[last].fetch_add(run, std::memory_order_relaxed);
            };
            for (std::size_t i = begin; i < end; ++i) {
                const std::uint32_t label = labelOf(i);
                if (targets.cluster && label != CorePoints::kNone)
                    putInteger(targets.cluster, targets.areWide, i, label);
                if (label != last) add(), last = label, run = 0;
                ++run;
            }
            add();
        });
        if (!targets.clusterSize) return;
        forEachChunk(particles, cancel, [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i < end; ++i) {
                const std::uint32_t label = labelOf(i);
                if (label != CorePoints::kNone)
                    putInteger(targets.clusterSize, targets.areWide, i,
                               size[label].load(std::memory_order_relaxed));
            }
        });
    }

private:
    Components mComponents;
    PageArray<char>& mRankMemory;
    std::optional<CorePoints> mCores;
};

} // namespace vdb_nns
