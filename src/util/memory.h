// Large buffers on huge pages, and (vdb_nns/memory.h) how much memory there is. Knows only the operating system.
#pragma once

#include "vdb_nns/memory.h"

#include <cstddef>
#include <cstdint>
#include <type_traits>
#include <utility>
#include <vector>

namespace vdb_nns {

// Anonymous pages, huge where the kernel gives them: first touch with 4 KiB pages is several times slower.
// Pages cost memory only once touched. Throws CapacityError when the address space is refused.
class PageBlock {
public:
    PageBlock() = default;
    explicit PageBlock(std::size_t bytes);
    ~PageBlock();
    PageBlock(PageBlock&& other) noexcept
        : mData(std::exchange(other.mData, nullptr)), mBytes(std::exchange(other.mBytes, 0))
    {
    }
    PageBlock& operator=(PageBlock&& other) noexcept
    {
        std::swap(mData, other.mData);
        std::swap(mBytes, other.mBytes);
        return *this;
    }

    void* data() const { return mData; }
    std::size_t bytes() const { return mBytes; }

private:
    void* mData = nullptr;
    std::size_t mBytes = 0;
};

// Asks for huge pages for those that lie whole inside of a range that is not touched yet.
void adviseHugePages(void* data, std::size_t bytes);

// resize() of an empty vector, whose first touch then takes a fifth of the time.
template <typename T>
void resizeOnHugePages(std::vector<T>& values, std::size_t size)
{
    values.reserve(size);
    adviseHugePages(values.data(), size * sizeof(T));
    values.resize(size);
}

// A growing array of trivial values whose contents are not kept when it grows.
template <typename T>
class PageArray {
    static_assert(std::is_trivial<T>::value, "contents are never constructed or copied");

public:
    // Makes room for `size` values and `kSlack` more that may be read or written past the end by vector code.
    void resizeDiscarding(std::size_t size)
    {
        const std::size_t needed = (size + kSlack) * sizeof(T);
        if (needed > mBlock.bytes()) mBlock = PageBlock(), mBlock = PageBlock(needed + needed / 16);
        mSize = size;
    }

    T* data() const { return static_cast<T*>(mBlock.data()); }
    std::size_t size() const { return mSize; }
    T& operator[](std::size_t i) const { return data()[i]; }
    T* begin() const { return data(); }
    T* end() const { return data() + mSize; }
    std::size_t usedBytes() const { return mSize * sizeof(T); }

    static constexpr std::size_t kSlack = 32; // two vectors of 16 lanes

private:
    PageBlock mBlock;
    std::size_t mSize = 0;
};

} // namespace vdb_nns
