// Copying particles around a leaf, at the end of the numbers that slots have.
#define VDB_NNS_SIMD_SSE4
#include "cpu/halo-inl.h"
#include "vdb_nns/search.h"

#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <vector>

#include <sys/mman.h>

namespace vdb_nns {

namespace {

// An array of 2^32 values and a vector more, of which only the pages that are used cost memory.
template <typename T>
class HugeArray {
public:
    HugeArray()
        : mData(::mmap(nullptr, kBytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE,
                       -1, 0))
    {
    }
    ~HugeArray()
    {
        if (isThere()) ::munmap(mData, kBytes);
    }
    HugeArray(const HugeArray&) = delete;
    HugeArray& operator=(const HugeArray&) = delete;

    bool isThere() const { return mData != MAP_FAILED; }
    T* data() const { return static_cast<T*>(mData); }

private:
    static constexpr std::size_t kBytes = ((std::size_t(1) << 32) + 64) * sizeof(T);
    void* mData;
};

TEST(Halo, CopiesTheLastSlotsThatThereCanBe)
{
    if (bestSimdLevel() < SimdLevel::kSse4) GTEST_SKIP() << "this processor has no SSE4";
    const HugeArray<float> x, y, z;
    const HugeArray<std::uint32_t> number;
    if (!x.isThere() || !y.isThere() || !z.isThere() || !number.isThere())
        GTEST_SKIP() << "64 GiB of address space are not to be had";
    constexpr std::uint32_t kEnd = 0xffffffffu, kBegin = kEnd - 19;
    for (std::uint32_t slot = kBegin; slot < kEnd; ++slot) {
        x.data()[slot] = static_cast<float>(slot - kBegin);
        number.data()[slot] = slot;
    }
    BlockView block{};
    block.x = x.data();
    block.y = y.data();
    block.z = z.data();
    block.number = number.data();
    constexpr std::size_t kStride = 64 * sizeof(float); // 19 particles and a vector more
    std::vector<float> memory(10 * kStride / sizeof(float));
    HaloScratch scratch{};
    scratch.base = reinterpret_cast<char*>(memory.data());
    scratch.stride = kStride;
    const char* const to = scratch.halo();
    const float shift[3] = {8, 0, -8};
    copyRun<false>(block, nullptr, scratch, 0, kBegin, kEnd, shift);
    for (std::uint32_t k = 0; k < kEnd - kBegin; ++k) {
        EXPECT_EQ(floats(to)[k], static_cast<float>(k) + 8);
        EXPECT_EQ(floats(to + 2 * kStride)[k], -8);
        EXPECT_EQ(integers(to + 4 * kStride)[k], kBegin + k);
    }
}

} // namespace

} // namespace vdb_nns
