#include "bench/methods/row_method.h"

#include <algorithm>
#include <stdexcept>

namespace vdb_nns::cli {

std::uint32_t RowPool::take(std::size_t least, std::uint32_t*& begin, std::size_t& size)
{
    const std::lock_guard<std::mutex> lock(mMutex);
    if (mUsed == mRows.buffers.size()) mRows.buffers.emplace_back();
    std::vector<std::uint32_t>& buffer = mRows.buffers[mUsed];
    if (buffer.size() < least) buffer = std::vector<std::uint32_t>(std::max(kNumbers, least));
    begin = buffer.data();
    size = buffer.size();
    return static_cast<std::uint32_t>(mUsed++);
}

void RowWriter::append(std::uint32_t query, const std::uint32_t* row, std::size_t count)
{
    std::copy(row, row + count, reserve(count));
    commit(query, static_cast<std::uint32_t>(count));
}

MethodRun RowMethod::run(const ParticleView& view, double radius, const ProgressSpan& span)
{
    return runSets({view, radius}, span);
}

MethodRun RowMethod::runSets(const SetSearch& sets, const ProgressSpan& span)
{
    discard();
    span.printer.begin("search", span.begin, span.end);
    mPool.restart();
    mRows.places.resize(sets.queries.view.size());
    if (!sets.queries.chosen.empty())
        std::fill(mRows.places.begin(), mRows.places.end(), RowBuffers::Place{});
    MethodRun result;
    search(sets, result);
    result.listBytes = mRows.places.size() * sizeof(RowBuffers::Place) + result.pairs * sizeof(std::uint32_t);
    mHasResult = true;
    return result;
}

const FoundNeighbors& RowMethod::found() const
{
    if (!mHasResult) throw std::logic_error("bench: a result was asked for that is not there");
    return mRows;
}

} // namespace vdb_nns::cli
