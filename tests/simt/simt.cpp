// The scheduler under simt.h: each thread of a block is a fibre, and the scheduler, on the caller's stack,
// resumes one that can go on, drawn at random, until all have ended or none can go on. Knows Boost.Context
// and the sanitizers' interface.
//
// Boost.Context's own fiber class runs frames of its own after a fibre's last switch is announced, on a stack
// that AddressSanitizer has already given up. The two functions below it, make and jump, leave the last frame
// to us.
#include "simt/simt.h"

#include <boost/context/detail/fcontext.hpp>
#include <boost/context/protected_fixedsize_stack.hpp>

#include <algorithm>
#include <exception>
#include <map>
#include <memory>
#include <numeric>
#include <random>
#include <sstream>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#if defined(SIMT_ASAN)
#include <sanitizer/common_interface_defs.h>
#define SIMT_NO_ASAN __attribute__((no_sanitize_address))
#else
#define SIMT_NO_ASAN
#endif

namespace simt {
namespace {

namespace context = boost::context;

// Kernels keep little on the stack; sanitizers, and a failed expectation in a kernel, want more. A guard page
// lies below.
constexpr std::size_t kStackBytes = 128 * 1024;
constexpr unsigned kMaxThreads = 1024; // of a block, as on all hardware

struct StackRange {
    const void* bottom = nullptr;
    std::size_t bytes = 0;
};

// AddressSanitizer must know which stack it is on. `save` keeps what belongs to the stack that is left, null
// if it ends.
SIMT_NO_ASAN void announceSwitch([[maybe_unused]] void** save, [[maybe_unused]] const StackRange& to)
{
#if defined(SIMT_ASAN)
    __sanitizer_start_switch_fiber(save, to.bottom, to.bytes);
#endif
}

SIMT_NO_ASAN void confirmSwitch([[maybe_unused]] void* saved, [[maybe_unused]] StackRange* from)
{
#if defined(SIMT_ASAN)
    __sanitizer_finish_switch_fiber(saved, from ? &from->bottom : nullptr, from ? &from->bytes : nullptr);
#endif
}

/// Stacks are kept from launch to launch: mapping them anew costs more than a small kernel.
class StackPool {
public:
    context::stack_context take()
    {
        if (mFree.empty()) return mAllocator.allocate();
        const context::stack_context stack = mFree.back();
        mFree.pop_back();
        return stack;
    }

    void give(const context::stack_context& stack) { mFree.push_back(stack); }

    ~StackPool()
    {
        for (context::stack_context& stack : mFree) mAllocator.deallocate(stack);
    }

private:
    context::protected_fixedsize_stack mAllocator{kStackBytes};
    std::vector<context::stack_context> mFree;
};

StackPool& stackPool()
{
    static StackPool pool;
    return pool;
}

/// Unwinds the threads that are left over when a launch has failed.
struct Abandoned {};

enum class State { kFresh, kReady, kWaiting, kDone };

struct Lane {
    uint3 index{};
    State state = State::kFresh;
    Meeting meeting{};
    std::uint64_t result = 0;
    context::stack_context stack;
    context::detail::fcontext_t resumeAt = nullptr;
    void* fakeStack = nullptr; // AddressSanitizer's

    StackRange stackRange() const { return {static_cast<const char*>(stack.sp) - stack.size, stack.size}; }
};

bool sameMeeting(const Meeting& a, const Meeting& b)
{
    const auto same = [](const char* s, const char* t) { return s == t || std::string_view(s) == t; };
    return a.line == b.line && a.mask == b.mask && same(a.name, b.name) && same(a.file, b.file);
}

class Scheduler {
public:
    Scheduler(dim3 block, std::size_t sharedBytes, std::uint64_t seed, const std::function<void()>& body)
        : mBody(body), mRandom(seed), mSharedBytes(sharedBytes), mLanes(block.x * block.y * block.z)
    {
        for (std::size_t i = 0; i < mLanes.size(); ++i) {
            const unsigned id = static_cast<unsigned>(i);
            mLanes[i].index = {id % block.x, id / block.x % block.y, id / block.x / block.y};
            mLanes[i].stack = stackPool().take();
        }
    }

    ~Scheduler()
    {
        for (Lane& lane : mLanes) stackPool().give(lane.stack);
    }

    Scheduler(const Scheduler&) = delete;
    Scheduler& operator=(const Scheduler&) = delete;

    void runBlock()
    {
        // Exactly as large as asked for, so that AddressSanitizer sees the first byte past its end.
        mShared = std::make_unique<unsigned char[]>(mSharedBytes);
        std::generate_n(mShared.get(), mSharedBytes,
                        [this] { return static_cast<unsigned char>(mRandom()); });
        mReady.clear();
        mWaiting.assign(mLanes.size() / warpSize + 1, 0);
        for (std::size_t i = 0; i < mLanes.size(); ++i) {
            mLanes[i].state = State::kFresh;
            mLanes[i].resumeAt = context::detail::make_fcontext(mLanes[i].stack.sp, mLanes[i].stack.size,
                                                                &Scheduler::enterLane);
            mReady.push_back(i);
        }
        while (!mReady.empty() && !mFailure) {
            std::swap(mReady[mRandom() % mReady.size()], mReady.back());
            const std::size_t next = mReady.back();
            mReady.pop_back();
            resume(next);
        }
        const auto isDone = [](const Lane& lane) { return lane.state == State::kDone; };
        if (!mFailure && !std::all_of(mLanes.begin(), mLanes.end(), isDone))
            mFailure = std::make_exception_ptr(Error(describeStuck()));
        if (mFailure) {
            abandonLanes();
            std::rethrow_exception(mFailure);
        }
    }

    // The rest is called by the thread that runs.

    void meetBlock(const Meeting& meeting)
    {
        startWaiting(meeting);
        const auto isHere = [&](const Lane& lane) {
            return lane.state == State::kWaiting && sameMeeting(lane.meeting, meeting);
        };
        if (std::all_of(mLanes.begin(), mLanes.end(), isHere)) {
            for (std::size_t i = 0; i < mLanes.size(); ++i) makeReady(i);
        }
        suspend();
    }

    std::uint64_t meetWarp(const Meeting& meeting, bool isShuffle)
    {
        if (!(meeting.mask >> laneInWarp() & 1))
            throw Error(describe(meeting) + ": the mask does not name its caller, " + describeThread());
        if (isShuffle && !(meeting.mask >> meeting.source & 1))
            throw Error(describe(meeting) + ": " + describeThread() + " reads lane " +
                        std::to_string(meeting.source) + ", which the mask does not name");
        startWaiting(meeting);
        const std::size_t first = mCurrent - mCurrent % warpSize;
        std::uint32_t here = 0, ballot = 0;
        const bool mayBeAll = mWaiting[mCurrent / warpSize] >= __popc(meeting.mask);
        for (std::size_t lane = 0; mayBeAll && lane < warpSize && first + lane < mLanes.size(); ++lane) {
            const Lane& other = mLanes[first + lane];
            if (other.state != State::kWaiting || !sameMeeting(other.meeting, meeting)) continue;
            here |= 1u << lane;
            ballot |= static_cast<std::uint32_t>(other.meeting.value != 0) << lane;
        }
        if (here == meeting.mask) { // only lanes of the mask get past the check above
            for (std::size_t lane = 0; lane < warpSize; ++lane) {
                if (!(here >> lane & 1)) continue;
                Lane& other = mLanes[first + lane];
                const std::size_t source = first + static_cast<std::size_t>(other.meeting.source);
                other.result = isShuffle ? mLanes[source].meeting.value : ballot;
                makeReady(first + lane);
            }
        }
        suspend();
        return mLanes[mCurrent].result;
    }

    void yieldLane()
    {
        makeReady(mCurrent);
        suspend();
    }

    int laneInWarp() const { return static_cast<int>(mCurrent % warpSize); }
    void* shared() { return mShared.get(); }

private:
    void startWaiting(const Meeting& meeting)
    {
        mLanes[mCurrent].meeting = meeting;
        mLanes[mCurrent].state = State::kWaiting;
        ++mWaiting[mCurrent / warpSize];
    }

    void makeReady(std::size_t lane)
    {
        if (mLanes[lane].state == State::kWaiting) --mWaiting[lane / warpSize];
        mLanes[lane].state = State::kReady;
        mReady.push_back(lane);
    }

    void resume(std::size_t next)
    {
        Lane& lane = mLanes[next];
        mCurrent = next;
        threadIdx = lane.index;
        void* fakeStack = nullptr;
        announceSwitch(&fakeStack, lane.stackRange());
        lane.resumeAt = context::detail::jump_fcontext(lane.resumeAt, this).fctx;
        confirmSwitch(fakeStack, nullptr);
    }

    void suspend()
    {
        Lane& lane = mLanes[mCurrent];
        announceSwitch(&lane.fakeStack, mHome);
        mResumeHome = context::detail::jump_fcontext(mResumeHome, nullptr).fctx;
        confirmSwitch(lane.fakeStack, &mHome);
        if (mFailure) throw Abandoned();
    }

    // The first and last frame of a fibre: it is never returned from, and after the last announcement its
    // stack may not hold anything of AddressSanitizer's.
    SIMT_NO_ASAN static void enterLane(context::detail::transfer_t from)
    {
        Scheduler* self = static_cast<Scheduler*>(from.data);
        confirmSwitch(nullptr, &self->mHome);
        self->mResumeHome = from.fctx;
        self->runBody();
        announceSwitch(nullptr, self->mHome);
        context::detail::jump_fcontext(self->mResumeHome, nullptr);
    }

    void runBody() noexcept
    {
        try {
            mBody();
        } catch (const Abandoned&) { // its launch throws what went wrong elsewhere
        } catch (...) {
            mFailure = std::current_exception();
        }
        mLanes[mCurrent].state = State::kDone;
    }

    void abandonLanes()
    {
        for (std::size_t i = 0; i < mLanes.size(); ++i)
            if (mLanes[i].state == State::kReady || mLanes[i].state == State::kWaiting) resume(i);
    }

    std::string describeThread() const
    {
        const uint3 t = mLanes[mCurrent].index;
        std::ostringstream text;
        text << "thread (" << t.x << ", " << t.y << ", " << t.z << ")";
        return text.str();
    }

    static std::string describe(const Meeting& meeting)
    {
        std::ostringstream text;
        text << meeting.name;
        if (meeting.mask) text << " with mask 0x" << std::hex << meeting.mask << std::dec;
        text << " at " << meeting.file << ":" << meeting.line;
        return text.str();
    }

    std::string describeStuck() const
    {
        std::map<std::string, std::pair<std::size_t, std::size_t>> waiting; // how many, and the first of them
        std::size_t exitedCount = 0;
        for (std::size_t i = 0; i < mLanes.size(); ++i) {
            if (mLanes[i].state == State::kDone)
                ++exitedCount;
            else
                ++waiting.try_emplace(describe(mLanes[i].meeting), 0, i).first->second.first;
        }
        std::ostringstream text;
        text << "block (" << blockIdx.x << ", " << blockIdx.y << ", " << blockIdx.z << ") is stuck";
        const char* separator = ": ";
        for (const auto& [where, lanes] : waiting) {
            text << separator << lanes.first << " of " << mLanes.size() << " threads wait in " << where
                 << " (first: number " << lanes.second << ")";
            separator = "; ";
        }
        text << separator << exitedCount << " have exited";
        return text.str();
    }

    const std::function<void()>& mBody;
    std::mt19937_64 mRandom;
    std::size_t mSharedBytes;
    std::unique_ptr<unsigned char[]> mShared;
    std::vector<Lane> mLanes;
    std::vector<std::size_t> mReady;
    std::vector<int> mWaiting; // threads of each warp
    std::size_t mCurrent = 0;
    std::exception_ptr mFailure;
    StackRange mHome; // the stack of the scheduler itself
    context::detail::fcontext_t mResumeHome = nullptr;
};

// What the primitives of simt.h act on: they are free functions, as CUDA's are.
Scheduler* gScheduler = nullptr;

Scheduler& scheduler()
{
    if (!gScheduler) throw Error("a device primitive is called outside a kernel");
    return *gScheduler;
}

struct RunningGuard {
    explicit RunningGuard(Scheduler& running) { gScheduler = &running; }
    ~RunningGuard() { gScheduler = nullptr; }
};

} // namespace

void meetBlock(const Meeting& meeting)
{
    scheduler().meetBlock(meeting);
}

std::uint32_t ballotWarp(const Meeting& meeting)
{
    return static_cast<std::uint32_t>(scheduler().meetWarp(meeting, false));
}

std::uint64_t shuffleWarp(const Meeting& meeting)
{
    return scheduler().meetWarp(meeting, true);
}

void yieldLane()
{
    scheduler().yieldLane();
}

int laneInWarp()
{
    return scheduler().laneInWarp();
}

void* dynamicShared()
{
    return scheduler().shared();
}

void runGrid(dim3 grid, dim3 block, std::size_t sharedBytes, std::uint64_t seed,
             const std::function<void()>& body)
{
    if (gScheduler) throw Error("a kernel is launched while another one runs");
    const std::uint64_t threads = std::uint64_t{block.x} * block.y * block.z;
    if (threads == 0 || block.x > kMaxThreads || block.y > kMaxThreads || threads > kMaxThreads)
        throw Error("a block has 1 to 1024 threads");
    const std::uint64_t plane = std::uint64_t{grid.x} * grid.y, blocks = plane * grid.z;
    if (blocks == 0) throw Error("a grid has at least one block");

    Scheduler running(block, sharedBytes, seed, body);
    const RunningGuard guard(running);
    std::vector<std::uint64_t> order(blocks);
    std::iota(order.begin(), order.end(), std::uint64_t{0});
    std::shuffle(order.begin(), order.end(), std::mt19937_64(seed));
    gridDim = grid;
    blockDim = block;
    for (const std::uint64_t i : order) {
        blockIdx = {static_cast<unsigned>(i % grid.x), static_cast<unsigned>(i % plane / grid.x),
                    static_cast<unsigned>(i / plane)};
        running.runBlock();
    }
}

} // namespace simt
