// Every number that tunes a kernel, each with what it trades. None changes a result. Figures: docs/gpu.md.
#pragma once

#include "shared/block_result.h"

namespace vdb_nns::cuda {

constexpr unsigned kWarpSize = 32;
constexpr unsigned kAllLanes = 0xffffffffu;
static_assert(kGroupQueries == kWarpSize, "a group is the queries of one warp, a lane each");

// Warps of a block of threads. They share nothing: more make fewer blocks to start, fewer leave less of a multiprocessor
// idle when one of them has a dense cell.
constexpr unsigned kWarps = 4;

// Words of candidates, 32 each, that a warp holds in registers at a time: x, y, z and the squared norm of each. 8 hold
// 256 candidates: at 8 particles a cell, a cell's 27 are 216, tested against all its queries after one gather. 16 would
// take 64 registers more and halve the warps of a multiprocessor.
constexpr int kWords = 8;

// Blocks of threads that a multiprocessor must be able to hold, which bounds the registers of a thread: to 102 with 5, so
// that 20 warps hide each other's loads. Rows of numbers need the candidates' numbers beside their positions: with 102
// registers some are spilled, so those have 128.
constexpr unsigned kSearchBlocks = 5, kNumberBlocks = 4;

// Threads of a block that adds up rows, each kTileGroups / kScanThreads of a tile.
constexpr unsigned kScanThreads = 256;

// Whether candidates are gathered, and a query's own bit is cleared, behind branches, as they were before compiled code was
// looked at: for a comparison on a GPU (tools/gpu_session.sh), which says whether that was worth it.
#if defined(VDB_NNS_FORMER_KERNELS)
constexpr bool kFormer = true;
#else
constexpr bool kFormer = false;
#endif

} // namespace vdb_nns::cuda
