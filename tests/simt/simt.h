// CUDA's execution model on the host, so that kernel sources compile with g++ and clang++ and run without a
// GPU. Include it before the kernel's source; it defines what device code names and nothing of the host's
// CUDA interface. Knows the standard library only; the fibres are in simt.cpp.
//
// Threads of a block are fibres that run one at a time. They change over at barriers, warp primitives and
// atomics, and who goes on is drawn from the seed, so what depends on the order of threads gives different
// answers for different seeds. Blocks run one after the other, in an order drawn from the seed too: a block
// that waits for another one never ends.
//
// Stricter than the hardware: a barrier or warp primitive needs every thread that it names, from one line of
// the source. If some have exited, never existed or wait elsewhere, launch() throws. So does a shuffle from a
// lane outside its mask. Not seen: a race between two barriers whose outcome is the same in every order of
// whole threads. Static __shared__ variables keep what the block before left in them; dynamic ones start as
// random bytes.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <functional>
#include <stdexcept>
#include <type_traits>

// clang++ 14 answers by __has_feature only, g++ 12 by the macro only.
#if defined(__has_feature)
#if __has_feature(address_sanitizer)
#define SIMT_ASAN
#endif
#elif defined(__SANITIZE_ADDRESS__)
#define SIMT_ASAN
#endif

// __restrict__ is a word of both compilers already. Blocks do not overlap, so a static variable is a block's
// own; and unlike a thread-local one it has AddressSanitizer's red zones. For that reason one launch runs at
// a time in a process.
#define __global__
#define __device__
#define __host__
#define __forceinline__ inline __attribute__((always_inline))
#define __launch_bounds__(...)
#define __grid_constant__
#define __noinline__
#define __shared__ static

// Stands for `extern __shared__ type name[]`, which no macro can turn into C++: `extern` and `static` exclude
// each other.
#define SIMT_DYNAMIC_SHARED(type, name) type* const name = static_cast<type*>(::simt::dynamicShared())

struct uint3 {
    unsigned x, y, z;
};

struct dim3 {
    unsigned x, y, z;
    dim3(unsigned width = 1, unsigned height = 1, unsigned depth = 1) : x(width), y(height), z(depth) {}
};

inline uint3 threadIdx, blockIdx;
inline dim3 blockDim, gridDim;
constexpr int warpSize = 32;

namespace simt {

/// A kernel, or a launch, that breaks the rules of the model; the message says which threads are where.
class Error : public std::logic_error {
public:
    using std::logic_error::logic_error;
};

/// What a thread waits for, and what it brings to it.
struct Meeting {
    const char* name;        // the primitive
    const char* file;        // the line that calls it
    int line;                //
    std::uint32_t mask = 0;  // lanes of the warp; unused by the barrier of a block
    std::uint64_t value = 0; // a predicate, or the bytes to shuffle
    int source = 0;          // the lane whose value a shuffle takes
};

void meetBlock(const Meeting& meeting);
std::uint32_t ballotWarp(const Meeting& meeting);
std::uint64_t shuffleWarp(const Meeting& meeting);

/// Lets other threads go first, or not, as the seed has it.
void yieldLane();

int laneInWarp();
void* dynamicShared();

void runGrid(dim3 grid, dim3 block, std::size_t sharedBytes, std::uint64_t seed,
             const std::function<void()>& body);

/// Runs a kernel to its end: what `kernel<<<grid, block, sharedBytes>>>(args...)` and a synchronisation do.
/// @throws Error for what the head of this file calls an error; and what the kernel itself throws
template <class... Parameters, class... Arguments>
void launch(void (*kernel)(Parameters...), dim3 grid, dim3 block, std::size_t sharedBytes, std::uint64_t seed,
            const Arguments&... args)
{
    runGrid(grid, block, sharedBytes, seed, [&] { kernel(args...); });
}

template <class T>
T shuffle(const char* name, std::uint32_t mask, T value, int source, const char* file, int line)
{
    static_assert(std::is_arithmetic_v<T> && sizeof(T) <= 8, "CUDA shuffles numbers of 4 and 8 bytes");
    Meeting meeting{name, file, line, mask, 0, source};
    std::memcpy(&meeting.value, &value, sizeof value);
    const std::uint64_t taken = shuffleWarp(meeting);
    std::memcpy(&value, &taken, sizeof value);
    return value;
}

/// Atomics order nothing, so a thread may be overtaken just before each.
template <class T>
T exchange(T* address, T (*change)(T, T), T operand)
{
    yieldLane();
    const T old = *address;
    *address = change(old, operand);
    return old;
}

} // namespace simt

inline void __syncthreads(const char* file = __builtin_FILE(), int line = __builtin_LINE())
{
    simt::meetBlock({"__syncthreads", file, line});
}

inline void __syncwarp(unsigned mask = 0xffffffffu, const char* file = __builtin_FILE(),
                       int line = __builtin_LINE())
{
    simt::ballotWarp({"__syncwarp", file, line, mask});
}

inline unsigned __ballot_sync(unsigned mask, int predicate, const char* file = __builtin_FILE(),
                              int line = __builtin_LINE())
{
    return simt::ballotWarp({"__ballot_sync", file, line, mask, predicate != 0});
}

inline int __any_sync(unsigned mask, int predicate, const char* file = __builtin_FILE(),
                      int line = __builtin_LINE())
{
    return simt::ballotWarp({"__any_sync", file, line, mask, predicate != 0}) != 0;
}

// Shuffles work in groups of `width` lanes, a power of two; who would read past its group reads itself,
// except that xor may read earlier groups.

template <class T>
T __shfl_sync(unsigned mask, T value, int source, int width = warpSize, const char* file = __builtin_FILE(),
              int line = __builtin_LINE())
{
    const int first = simt::laneInWarp() & -width;
    return simt::shuffle("__shfl_sync", mask, value, first + (source & (width - 1)), file, line);
}

template <class T>
T __shfl_up_sync(unsigned mask, T value, unsigned delta, int width = warpSize,
                 const char* file = __builtin_FILE(), int line = __builtin_LINE())
{
    const int lane = simt::laneInWarp(), source = lane - static_cast<int>(delta);
    return simt::shuffle("__shfl_up_sync", mask, value, source < (lane & -width) ? lane : source, file, line);
}

template <class T>
T __shfl_down_sync(unsigned mask, T value, unsigned delta, int width = warpSize,
                   const char* file = __builtin_FILE(), int line = __builtin_LINE())
{
    const int lane = simt::laneInWarp(), source = lane + static_cast<int>(delta);
    return simt::shuffle("__shfl_down_sync", mask, value, source >= (lane & -width) + width ? lane : source,
                         file, line);
}

template <class T>
T __shfl_xor_sync(unsigned mask, T value, int laneMask, int width = warpSize,
                  const char* file = __builtin_FILE(), int line = __builtin_LINE())
{
    const int lane = simt::laneInWarp(), source = lane ^ laneMask;
    return simt::shuffle("__shfl_xor_sync", mask, value, source >= (lane & -width) + width ? lane : source,
                         file, line);
}

inline int __popc(unsigned word)
{
    return __builtin_popcount(word);
}

inline int __popcll(unsigned long long word)
{
    return __builtin_popcountll(word);
}

inline int __ffs(int word)
{
    return __builtin_ffs(word);
}

inline int __clz(int word)
{
    return word == 0 ? 32 : __builtin_clz(static_cast<unsigned>(word)); // the builtin leaves 0 undefined
}

inline unsigned atomicAdd(unsigned* address, unsigned value)
{
    return simt::exchange<unsigned>(
        address, [](unsigned a, unsigned b) { return a + b; }, value);
}

inline unsigned long long atomicAdd(unsigned long long* address, unsigned long long value)
{
    using Word = unsigned long long;
    return simt::exchange<Word>(
        address, [](Word a, Word b) { return a + b; }, value);
}

inline unsigned atomicOr(unsigned* address, unsigned value)
{
    return simt::exchange<unsigned>(
        address, [](unsigned a, unsigned b) { return a | b; }, value);
}
