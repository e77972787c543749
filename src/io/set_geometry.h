// Distances and the order of rows of a search of two sets, for writers of lists.
#pragma once

#include "exact/distance_order.h"
#include "exact/exact_test.h"
#include "grid/search_sets_data.h"
#include "io/npz_writer.h"
#include "points/pair_geometry.h"

#include <tbb/enumerable_thread_specific.h>

namespace vdb_nns {

class SetGeometry final : public RowGeometry {
public:
    explicit SetGeometry(const SearchSets& sets)
        : mSets(sets),
          mDistance(sets.queries(), sets.candidates()),
          mExact(sets.queries(), sets.candidates(), sets.data().radius, sets.radius()),
          mOrders([this] { return DistanceOrder(mExact); })
    {
    }

    double distance(std::size_t row, std::size_t neighbor) const override { return mDistance(row, neighbor); }
    void order(std::size_t row, std::uint32_t* numbers, std::size_t count) const override
    {
        mOrders.local().order(static_cast<std::uint32_t>(row), numbers, count);
    }

private:
    const SearchSets mSets;
    const PairDistance mDistance;
    const ExactTest mExact;
    mutable tbb::enumerable_thread_specific<DistanceOrder> mOrders;
};

} // namespace vdb_nns
