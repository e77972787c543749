// The emulation of CUDA's execution model, before any kernel is judged by it: each primitive worked out by
// hand, small kernels over seeds, and planted faults that must be found. Knows simt.h only.
#include "simt/simt.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdlib>
#include <numeric>
#include <set>
#include <stdexcept>
#include <string>
#include <vector>

namespace vdb_nns::testing {

namespace {

constexpr unsigned kAll = 0xffffffffu;
constexpr std::uint64_t kSeedCount = 20;

template <class Launch>
std::string errorOf(const Launch& launch)
{
    try {
        launch();
    } catch (const simt::Error& error) {
        return error.what();
    }
    return "no error";
}

__global__ void numberThreadsKernel(unsigned* count, unsigned* widths)
{
    const unsigned block = (blockIdx.z * gridDim.y + blockIdx.y) * gridDim.x + blockIdx.x;
    const unsigned thread = (threadIdx.z * blockDim.y + threadIdx.y) * blockDim.x + threadIdx.x;
    count[block * blockDim.x * blockDim.y * blockDim.z + thread] += 1;
    if (thread == 0) widths[block] = gridDim.x * 100 + blockDim.x;
}

TEST(Simt, RunsEveryThreadOfEveryBlockOnce)
{
    std::vector<unsigned> count(24 * 30), widths(24);
    simt::launch(numberThreadsKernel, dim3(2, 3, 4), dim3(5, 2, 3), 0, 1, count.data(), widths.data());
    EXPECT_EQ(count, std::vector<unsigned>(24 * 30, 1));
    EXPECT_EQ(widths, std::vector<unsigned>(24, 205));
}

__global__ void recordOrderKernel(unsigned* order, unsigned* next)
{
    order[atomicAdd(next, 1u)] = blockIdx.x * blockDim.x + threadIdx.x;
}

std::vector<unsigned> orderOf(std::uint64_t seed)
{
    std::vector<unsigned> order(4 * 8);
    unsigned next = 0;
    simt::launch(recordOrderKernel, 4, 8, 0, seed, order.data(), &next);
    return order;
}

TEST(Simt, OrderFollowsTheSeed)
{
    std::set<std::vector<unsigned>> orders;
    std::set<unsigned> firstBlocks;
    for (std::uint64_t seed = 0; seed < kSeedCount; ++seed) {
        std::vector<unsigned> order = orderOf(seed);
        EXPECT_EQ(order, orderOf(seed));
        orders.insert(order);
        firstBlocks.insert(order[0] / 8);
        std::sort(order.begin(), order.end());
        for (unsigned i = 0; i < order.size(); ++i) EXPECT_EQ(order[i], i);
    }
    EXPECT_EQ(orders.size(), kSeedCount);
    EXPECT_GT(firstBlocks.size(), 1u);
}

TEST(Simt, BitFunctions)
{
    EXPECT_EQ(__popc(0u), 0);
    EXPECT_EQ(__popc(0xf0f00001u), 9);
    EXPECT_EQ(__popcll(0xffff0000000000ffull), 24);
    EXPECT_EQ(__ffs(0), 0);
    EXPECT_EQ(__ffs(1), 1);
    EXPECT_EQ(__ffs(0x50), 5);
    EXPECT_EQ(__clz(0), 32);
    EXPECT_EQ(__clz(1), 31);
    EXPECT_EQ(__clz(-1), 0);
}

__global__ void atomicsKernel(unsigned* sum, unsigned long long* wideSum, unsigned* bits)
{
    atomicAdd(sum, 3u);
    atomicAdd(wideSum, 1ull << 31);
    atomicOr(bits, 1u << (threadIdx.x % 32));
}

TEST(Simt, Atomics)
{
    unsigned sum = 5, bits = 0;
    unsigned long long wideSum = 7;
    simt::launch(atomicsKernel, 2, 20, 0, 3, &sum, &wideSum, &bits);
    EXPECT_EQ(sum, 5u + 3 * 40);
    EXPECT_EQ(wideSum, 7 + (40ull << 31));
    EXPECT_EQ(bits, 0xfffffu);
}

__global__ void votesKernel(unsigned* ballots, int* any)
{
    const unsigned i = threadIdx.x;
    ballots[i] = __ballot_sync(kAll, i % 3 == 0 ? 2 : 0);
    any[i] = __any_sync(kAll, i == 40);
}

TEST(Simt, Votes)
{
    std::vector<unsigned> ballots(64);
    std::vector<int> any(64);
    simt::launch(votesKernel, 1, 64, 0, 4, ballots.data(), any.data());
    for (unsigned i = 0; i < 64; ++i) {
        EXPECT_EQ(ballots[i], i < 32 ? 0x49249249u : 0x92492492u) << i; // 0 3 .. 30, then 33 36 .. 63
        EXPECT_EQ(any[i], i < 32 ? 0 : 1) << i;
    }
}

using Shuffles = std::array<int, 8>;

__global__ void shufflesKernel(Shuffles* out, double* wide)
{
    const int lane = static_cast<int>(threadIdx.x), value = 100 + lane;
    Shuffles& mine = out[lane];
    mine[0] = __shfl_sync(kAll, value, 5);
    mine[1] = __shfl_sync(kAll, value, lane + 33); // modulo the width
    mine[2] = __shfl_sync(kAll, value, 1, 8);
    mine[3] = __shfl_up_sync(kAll, value, 2);
    mine[4] = __shfl_up_sync(kAll, value, 1, 8);
    mine[5] = __shfl_down_sync(kAll, value, 3);
    mine[6] = __shfl_xor_sync(kAll, value, 1);
    mine[7] = __shfl_xor_sync(kAll, value, 8, 8);
    wide[lane] = __shfl_down_sync(kAll, 0.5 + lane, 1, 16);
}

TEST(Simt, Shuffles)
{
    std::vector<Shuffles> out(32);
    std::vector<double> wide(32);
    simt::launch(shufflesKernel, 1, 32, 0, 5, out.data(), wide.data());
    // Lanes 0, 1, 8, 17 and 31, each by hand.
    EXPECT_EQ(out[0], (Shuffles{105, 101, 101, 100, 100, 103, 101, 100}));
    EXPECT_EQ(out[1], (Shuffles{105, 102, 101, 101, 100, 104, 100, 101}));
    EXPECT_EQ(out[8], (Shuffles{105, 109, 109, 106, 108, 111, 109, 100}));
    EXPECT_EQ(out[17], (Shuffles{105, 118, 117, 115, 116, 120, 116, 117}));
    EXPECT_EQ(out[31], (Shuffles{105, 100, 125, 129, 130, 131, 130, 123}));
    EXPECT_EQ(wide[14], 15.5);
    EXPECT_EQ(wide[15], 15.5); // the end of its group of 16: its own
    EXPECT_EQ(wide[16], 17.5);
}

// One lane writes, and the others read after the barrier.
__global__ void warpMessageKernel(int* out)
{
    __shared__ int message[2];
    const unsigned warp = threadIdx.x / 32;
    if (threadIdx.x % 32 == 7) message[warp] = static_cast<int>(10 + warp);
    __syncwarp();
    out[threadIdx.x] = message[warp];
}

TEST(Simt, WarpBarrier)
{
    for (std::uint64_t seed = 0; seed < kSeedCount; ++seed) {
        std::vector<int> out(64);
        simt::launch(warpMessageKernel, 1, 64, 0, seed, out.data());
        for (unsigned i = 0; i < 64; ++i) EXPECT_EQ(out[i], i < 32 ? 10 : 11);
    }
}

// The sum of each block's 128 values. Without the barriers, a thread may add what its partner has not
// written.
template <bool kWithBarriers>
__global__ void __launch_bounds__(128) sumBlockKernel(const int* __restrict__ in, int* __restrict__ out)
{
    __shared__ int part[128];
    part[threadIdx.x] = in[blockIdx.x * blockDim.x + threadIdx.x];
    if (kWithBarriers) __syncthreads();
    for (unsigned step = blockDim.x / 2; step > 0; step /= 2) {
        if (threadIdx.x < step) part[threadIdx.x] += part[threadIdx.x + step];
        if (kWithBarriers) __syncthreads();
    }
    if (threadIdx.x == 0) out[blockIdx.x] = part[0];
}

template <bool kWithBarriers>
std::vector<int> sumBlocks(std::uint64_t seed)
{
    std::vector<int> in(3 * 128), out(3);
    std::iota(in.begin(), in.end(), 1);
    simt::launch(sumBlockKernel<kWithBarriers>, 3, 128, 0, seed, in.data(), out.data());
    return out;
}

const std::vector<int> kBlockSums = {8256, 24640, 41024}; // 128 * 129 / 2, and 128 * 128 more each

TEST(Simt, BlockReduction)
{
    for (std::uint64_t seed = 0; seed < kSeedCount; ++seed) EXPECT_EQ(sumBlocks<true>(seed), kBlockSums);
}

TEST(SimtFault, MissingBarriersGiveWrongSums)
{
    std::uint64_t wrongCount = 0;
    for (std::uint64_t seed = 0; seed < kSeedCount; ++seed)
        wrongCount += sumBlocks<false>(seed) != kBlockSums;
    EXPECT_EQ(wrongCount, kSeedCount);
}

// Each thread hands its value on to the next one, twice, through one array: the second barrier of a turn
// keeps the fast ones from overwriting what the slow ones still read.
template <bool kWithSecondBarrier>
__global__ void rotateKernel(int* values)
{
    __shared__ int slots[2];
    for (int turn = 0; turn < 2; ++turn) {
        slots[threadIdx.x] = values[threadIdx.x];
        __syncthreads();
        values[threadIdx.x] = slots[(threadIdx.x + 1) % blockDim.x] + 1;
        if (kWithSecondBarrier) __syncthreads();
    }
}

template <bool kWithSecondBarrier>
std::vector<int> rotate(std::uint64_t seed)
{
    std::vector<int> values = {10, 20};
    simt::launch(rotateKernel<kWithSecondBarrier>, 1, 2, 0, seed, values.data());
    return values;
}

TEST(SimtFault, AMissingSecondBarrierIsFoundByItsSeed)
{
    const std::vector<int> right = {12, 22};
    for (std::uint64_t seed = 0; seed < kSeedCount; ++seed) EXPECT_EQ(rotate<true>(seed), right);
    // Whoever reads first goes on to write, and spoils the read of the other: every order of two threads is
    // wrong, and which of the two values is spoilt depends on the seed.
    std::set<std::vector<int>> wrong;
    for (std::uint64_t seed = 0; seed < kSeedCount; ++seed) wrong.insert(rotate<false>(seed));
    EXPECT_EQ(wrong.count(right), 0u);
    EXPECT_GT(wrong.size(), 1u);
}

// Publishes a value and reads it with no barrier between: right whenever the writer happens to go first.
__global__ void publishKernel(int* out)
{
    __shared__ int value;
    value = 0;
    __syncthreads();
    if (threadIdx.x == 0) value = 42;
    if (threadIdx.x == 1) *out = value;
}

TEST(SimtFault, ARaceIsRightForSomeSeedsAndWrongForOthers)
{
    std::set<int> seen;
    for (std::uint64_t seed = 0; seed < kSeedCount; ++seed) {
        int out = -1;
        simt::launch(publishKernel, 1, 2, 0, seed, &out);
        seen.insert(out);
    }
    EXPECT_EQ(seen, (std::set<int>{0, 42}));
}

__device__ __forceinline__ unsigned bitsBelow(unsigned lane)
{
    return (1u << lane) - 1;
}

// Multiples of 3, in order, in a warp's part of the output.
__global__ void compactKernel(const unsigned* in, unsigned* out, unsigned* count)
{
    const unsigned i = blockIdx.x * blockDim.x + threadIdx.x, lane = threadIdx.x % 32;
    const bool keep = in[i] % 3 == 0;
    const unsigned kept = __ballot_sync(kAll, keep);
    if (keep) out[i - lane + static_cast<unsigned>(__popc(kept & bitsBelow(lane)))] = in[i];
    if (lane == 0) count[i / 32] = static_cast<unsigned>(__popc(kept));
}

TEST(Simt, WarpCompaction)
{
    std::vector<unsigned> in(4 * 64);
    for (unsigned i = 0; i < in.size(); ++i) in[i] = i * 7 % 101;
    for (std::uint64_t seed = 0; seed < kSeedCount; ++seed) {
        std::vector<unsigned> out(in.size()), count(in.size() / 32);
        simt::launch(compactKernel, 4, 64, 0, seed, in.data(), out.data(), count.data());
        for (unsigned warp = 0; warp < count.size(); ++warp) {
            std::vector<unsigned> expected;
            for (unsigned i = warp * 32; i < warp * 32 + 32; ++i)
                if (in[i] % 3 == 0) expected.push_back(in[i]);
            const auto first = out.begin() + warp * 32;
            EXPECT_EQ(std::vector<unsigned>(first, first + count[warp]), expected);
        }
    }
}

// Odd and even lanes go different ways, with their own masks and numbers of turns, and meet again.
__global__ void divergeKernel(unsigned* sums, unsigned* ballots)
{
    const unsigned lane = threadIdx.x;
    unsigned sum = lane;
    if (lane % 2 == 0) {
        for (int step = 2; step < 32; step *= 2) sum += __shfl_xor_sync(0x55555555u, sum, step);
    } else {
        sum = __ballot_sync(0xaaaaaaaau, lane < 8);
        __syncwarp(0xaaaaaaaau);
    }
    sums[lane] = sum;
    ballots[lane] = __ballot_sync(kAll, sum == 240);
}

TEST(Simt, DivergentLanesMeetByTheirMasks)
{
    for (std::uint64_t seed = 0; seed < kSeedCount; ++seed) {
        std::vector<unsigned> sums(32), ballots(32);
        simt::launch(divergeKernel, 1, 32, 0, seed, sums.data(), ballots.data());
        for (unsigned lane = 0; lane < 32; ++lane) {
            EXPECT_EQ(sums[lane], lane % 2 == 0 ? 240u : 0xaau); // 0 + 2 + .. + 30; lanes 1 3 5 7
            EXPECT_EQ(ballots[lane], 0x55555555u);
        }
    }
}

__global__ void reverseKernel(float* values)
{
    SIMT_DYNAMIC_SHARED(float, copy);
    copy[threadIdx.x] = values[blockIdx.x * blockDim.x + threadIdx.x];
    __syncthreads();
    values[blockIdx.x * blockDim.x + threadIdx.x] = copy[blockDim.x - 1 - threadIdx.x];
}

TEST(Simt, DynamicSharedMemory)
{
    std::vector<float> values = {1, 2, 3, 4, 5, 6};
    simt::launch(reverseKernel, 2, 3, 3 * sizeof(float), 6, values.data());
    EXPECT_EQ(values, (std::vector<float>{3, 2, 1, 6, 5, 4}));
}

__global__ void readUnwrittenKernel(std::uint64_t* out)
{
    SIMT_DYNAMIC_SHARED(std::uint64_t, word);
    out[blockIdx.x] = word[0];
}

TEST(SimtFault, UnwrittenDynamicSharedMemoryIsRandom)
{
    std::vector<std::uint64_t> out(3);
    simt::launch(readUnwrittenKernel, 3, 1, sizeof(std::uint64_t), 7, out.data());
    EXPECT_EQ(std::set<std::uint64_t>(out.begin(), out.end()).size(), 3u);
}

/// Counts the threads that were unwound.
struct Witness {
    int* count;
    ~Witness() { ++*count; }
};

__global__ void someReachBarrierKernel(int* unwound)
{
    const Witness witness{unwound};
    if (threadIdx.x >= 3) __syncthreads();
}

TEST(SimtFault, ABarrierThatSomeThreadsMissThrows)
{
    for (std::uint64_t seed = 0; seed < kSeedCount; ++seed) {
        int unwound = 0;
        const std::string error =
            errorOf([&] { simt::launch(someReachBarrierKernel, 1, 40, 0, seed, &unwound); });
        EXPECT_NE(error.find("block (0, 0, 0) is stuck: 37 of 40 threads wait in __syncthreads at "),
                  std::string::npos)
            << error;
        EXPECT_NE(error.find("(first: number 3); 3 have exited"), std::string::npos) << error;
        EXPECT_EQ(unwound, 40);
    }
}

__global__ void twoBarriersKernel()
{
    if (threadIdx.x < 32) {
        __syncthreads();
    } else {
        __syncthreads();
    }
}

TEST(SimtFault, TwoBarriersAreNotOne)
{
    const std::string error = errorOf([] { simt::launch(twoBarriersKernel, 1, 64, 0, 8); });
    EXPECT_NE(error.find("32 of 64 threads wait in __syncthreads at "), std::string::npos) << error;
    EXPECT_NE(error.find("(first: number 32); 0 have exited"), std::string::npos) << error;
}

__global__ void fullMaskInBranchKernel(int* out)
{
    if (threadIdx.x < 20) *out = __shfl_sync(kAll, 1, 0);
}

__global__ void wrongMasksKernel(unsigned* out)
{
    out[threadIdx.x] = __ballot_sync(threadIdx.x < 16 ? 0xffffu : kAll, 1);
}

__global__ void ballotAndBarrierKernel(unsigned* out)
{
    if (threadIdx.x == 9) __syncthreads();
    out[threadIdx.x] = __ballot_sync(kAll, 1);
}

__global__ void notNamedKernel()
{
    __syncwarp(0xfffffffeu);
}

__global__ void readsOutsideMaskKernel(int* out)
{
    if (threadIdx.x < 4) out[threadIdx.x] = __shfl_down_sync(0xfu, 1, 4);
}

TEST(SimtFault, WarpPrimitivesThatSomeLanesMissThrow)
{
    std::array<int, 32> out{};
    std::array<unsigned, 32> words{};
    const auto expect = [](const std::string& error, const char* part) {
        EXPECT_NE(error.find(part), std::string::npos) << error;
    };
    expect(errorOf([&] { simt::launch(fullMaskInBranchKernel, 1, 32, 0, 9, out.data()); }),
           "20 of 32 threads wait in __shfl_sync with mask 0xffffffff at ");
    expect(errorOf([&] { simt::launch(wrongMasksKernel, 1, 32, 0, 9, words.data()); }),
           "16 of 32 threads wait in __ballot_sync with mask 0xffffffff at ");
    const std::string mixed =
        errorOf([&] { simt::launch(ballotAndBarrierKernel, 1, 32, 0, 9, words.data()); });
    expect(mixed, "31 of 32 threads wait in __ballot_sync");
    expect(mixed, "1 of 32 threads wait in __syncthreads");
    // The mask names lanes that the second warp of the block does not have.
    expect(errorOf([&] { simt::launch(votesKernel, 1, 48, 0, 9, words.data(), out.data()); }),
           "wait in __ballot_sync");
    expect(errorOf([] { simt::launch(notNamedKernel, 1, 32, 0, 9); }),
           "the mask does not name its caller, thread (0, 0, 0)");
    expect(errorOf([&] { simt::launch(readsOutsideMaskKernel, 1, 32, 0, 9, out.data()); }),
           "which the mask does not name");
}

__global__ void throwKernel(int* unwound)
{
    const Witness witness{unwound};
    __syncthreads();
    if (threadIdx.x == 5) throw std::out_of_range("thread 5");
    __syncthreads();
}

TEST(SimtFault, WhatAKernelThrowsReachesTheCaller)
{
    int unwound = 0;
    EXPECT_THROW(simt::launch(throwKernel, 1, 40, 0, 10, &unwound), std::out_of_range);
    EXPECT_EQ(unwound, 40);
}

TEST(SimtFault, BadLaunchesThrow)
{
    const auto nothing = static_cast<void (*)()>([] {});
    EXPECT_THROW(simt::launch(nothing, 0, 32, 0, 0), simt::Error);
    EXPECT_THROW(simt::launch(nothing, 1, 0, 0, 0), simt::Error);
    EXPECT_THROW(simt::launch(nothing, 1, dim3(32, 33), 0, 0), simt::Error);
    EXPECT_NO_THROW(simt::launch(nothing, 1, dim3(32, 32), 0, 0));
    EXPECT_THROW(__syncthreads(), simt::Error);
    const auto nested = static_cast<void (*)()>([] { simt::launch(twoBarriersKernel, 1, 1, 0, 0); });
    EXPECT_THROW(simt::launch(nested, 1, 1, 0, 0), simt::Error);
}

#if defined(SIMT_ASAN)

/// Not inlined: the undefined-behaviour sanitizer, which knows the size of a variable in sight, would be the
/// first to object.
__device__ __attribute__((noinline)) void store(float* address, std::size_t index, float value)
{
    address[index] = value;
}

// Every thread passes a barrier first, so that the fault is found on a stack that has been left and entered
// again.

__global__ void writePastSharedKernel(std::size_t index)
{
    __shared__ float values[64];
    values[threadIdx.x] = 0;
    __syncthreads();
    store(values, threadIdx.x + index, 1);
}

__global__ void writePastDynamicSharedKernel(std::size_t index)
{
    SIMT_DYNAMIC_SHARED(float, values);
    __syncthreads();
    store(values, threadIdx.x + index, 1);
}

__global__ void writePastGlobalKernel(float* values, std::size_t index)
{
    __syncthreads();
    store(values, threadIdx.x + index, 1);
}

__global__ void writePastLocalKernel(std::size_t index)
{
    float values[64] = {};
    __syncthreads();
    store(values, threadIdx.x + index, 1);
}

TEST(SimtFault, AddressSanitizerFindsWritesPastTheEnd)
{
    std::vector<float> values(64);
    const std::size_t bytes = 64 * sizeof(float);
    EXPECT_NO_THROW(simt::launch(writePastSharedKernel, 1, 64, 0, 11, 0));
    EXPECT_NO_THROW(simt::launch(writePastDynamicSharedKernel, 1, 64, bytes, 11, 0));
    EXPECT_NO_THROW(simt::launch(writePastGlobalKernel, 1, 64, 0, 11, values.data(), 0));
    EXPECT_NO_THROW(simt::launch(writePastLocalKernel, 1, 64, 0, 11, 0));
    EXPECT_DEATH(simt::launch(writePastSharedKernel, 1, 64, 0, 11, 1), "global-buffer-overflow");
    EXPECT_DEATH(simt::launch(writePastDynamicSharedKernel, 1, 64, bytes, 11, 1), "heap-buffer-overflow");
    EXPECT_DEATH(simt::launch(writePastGlobalKernel, 1, 64, 0, 11, values.data(), 1), "heap-buffer-overflow");
    EXPECT_DEATH(simt::launch(writePastLocalKernel, 1, 64, 0, 11, 1), "stack-buffer-overflow");
}

// Not told of a switch, AddressSanitizer warns when an exception unwinds a stack that it does not know.
TEST(SimtFault, AddressSanitizerKnowsTheStacks)
{
    const auto throwAndExit = [] {
        int unwound = 0;
        EXPECT_THROW(simt::launch(throwKernel, 1, 40, 0, 10, &unwound), std::out_of_range);
        std::_Exit(0);
    };
    EXPECT_EXIT(throwAndExit(), ::testing::ExitedWithCode(0), "^$");
}

#endif

} // namespace

} // namespace vdb_nns::testing
