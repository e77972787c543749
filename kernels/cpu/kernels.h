// The functions that are compiled once for each instruction set (search_scalar.cpp, search_sse4.cpp, ...), and the choice
// among them.
#pragma once

#include "cpu/measure_rows.h"
#include "vdb_nns/search_options.h"

#include <cstddef>
#include <cstdint>

namespace vdb_nns {

struct SearchContext;
struct SearchTask;
struct ExactPredicate;
struct HaloScratch;
struct RowSink;
struct TaskStatistics;
struct CellCounts;
struct BlockView;

using SearchTaskFunction = void (*)(const SearchContext&, const SearchTask&, const ExactPredicate&,
                                    HaloScratch&, RowSink&, TaskStatistics&);

// Splits cell coordinates t into the number of the leaf and the coordinate about the leaf's centre. False when one of
// them is not inside +-limit; NaN is not.
using LocateAxisFunction = bool (*)(const double* t, std::size_t count, double limit, std::int32_t* leaf,
                                    float* local);

// Draws cubes by a hash of their coordinates, which are `rows` times the position rounded down: 1 for a position in one whose
// hash is at most `last`, else 0. Arbitrary for positions that are not finite or pass 2^31 cubes.
using SampleCubesFunction = void (*)(const double* x, const double* y, const double* z, std::size_t count,
                                     const double (*rows)[3], std::uint32_t last, std::uint8_t* drawn);

// For each occupied cell of a leaf: the particles of the cells in its reach, and their sum weighted by `shares`, which
// has (2 reach + 1)^3 of them by offset, lexicographic.
using ExpectCellsFunction = void (*)(const BlockView&, std::uint32_t leaf, const std::uint32_t* neighborhood,
                                     const float* shares, CellCounts&, float* expected,
                                     std::uint32_t* candidates);

// Writes the numbers of a row ascending to another place, and up to kSortOverrun entries behind them that mean nothing: rows
// are sorted one behind the other. `scratch` has room for sortScratchEntries(count).
using SortRowFunction = void (*)(const std::uint32_t* row, std::size_t count, std::uint32_t* out,
                                 std::uint32_t* scratch);
constexpr std::size_t kSortOverrun = 15;
// Long rows are filled up to a multiple of what is sorted in registers, which is no more than this.
constexpr std::size_t kLargestSortBlock = 128;
constexpr std::size_t sortScratchEntries(std::size_t count)
{
    return 2 * (count + kLargestSortBlock);
}

// One for each kind of row.
struct RowKernels {
    SearchTaskFunction
        index; // rows of numbers, past the caches; the last ones of a thread wait in RowSink::tail
    SearchTaskFunction visit; // rows of numbers, to be read at once
    SearchTaskFunction
        smaller; // the same, of numbers smaller than the query's; null where pairs may go one way
    SearchTaskFunction
        half; // rows as of `visit`, but each pair of a leaf once where RowSink::areHalf says so; null likewise
    SearchTaskFunction mask;  // rows of membership bits; null if rows are cut to the nearest
    SearchTaskFunction count; // counts alone; of rows that are cut too, all neighbors
};

// By what becomes of a row.
struct SetKernels {
    RowKernels whole, nearest; // nearest: rows are cut to SetContext::nearest
};

// kernel_table-inl.h fills it, by position.
struct Kernels {
    RowKernels plain;        // the candidates are the queries, and one radius serves all
    SetKernels queryRadius;  // of SearchContext::sets; the radius of the query decides
    SetKernels largerRadius; // the larger one of the two does
    LocateAxisFunction locateAxis;
    SampleCubesFunction sampleCubes;
    ExpectCellsFunction expectCells;
    SortRowFunction sortRow;
    MeasureKernels measure;
};

extern const Kernels kKernelsScalar, kKernelsSse4, kKernelsAvx2, kKernelsAvx512;

// kBest is the widest that this processor has.
const Kernels& kernelsFor(SimdLevel level);

} // namespace vdb_nns
