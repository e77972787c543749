// Whether shared data may be used again.
#pragma once

#include <atomic>
#include <memory>

namespace vdb_nns {

// True when no other handle of the data is left, so that it may be changed. Null has no owner.
template <typename T>
bool isSoleOwner(const std::shared_ptr<T>& handle)
{
    if (handle.use_count() != 1) return false;
    // The count is read without order. The last other handle may just have gone on another thread: what that thread read
    // through it must happen before what is written now.
    std::atomic_thread_fence(std::memory_order_acquire);
    return true;
}

} // namespace vdb_nns
