// The studies of radii of particles and of the nearest: ours beside what one does without them, time and
// wrong pairs.
#pragma once

#include "bench/accuracy.h"
#include "bench/bench_points.h"
#include "bench/method.h"
#include "bench/truth.h"

#include <cstdint>
#include <exception>
#include <string>
#include <vector>

namespace vdb_nns::cli {

struct SetResult {
    std::string scene;
    std::string radii;         ///< what they are; "one" where one serves all
    std::string mode;          ///< gather, scatter or symmetric; empty with one radius
    std::uint32_t nearest = 0; ///< that are asked for; 0: all
    std::string method;
    bool isOurs = false; ///< promises exact pairs
    std::uint64_t points = 0;
    std::uint64_t queries = 0; ///< that were timed: fewer than points where all would take minutes
    std::uint64_t runs = 0;
    std::uint64_t pairs = 0; ///< of those queries
    /// Medians; search and total are scaled up to all particles where fewer were timed.
    double gridSeconds = 0, searchSeconds = 0, totalSeconds = 0, minSeconds = 0, maxSeconds = 0;
    double ratio = 0;            ///< of the total to ours; 0 where ours has none
    WrongPairs wrong;            ///< of those queries that the truth has, too
    std::uint64_t truePairs = 0; ///< of these
    bool isComplete = false;     ///< the truth has all particles
    std::string message;         ///< of a refusal; then there are no figures
    std::exception_ptr refusal;
};

struct SetStudyOptions {
    SearchOptions search;
    double radius = 0;
    std::uint64_t repeat = 5, seed = 1; ///< timed runs of each, interleaved, after one that warms up
    TruthOptions truth;
    double mostTests = 2e10; ///< of the engine in a run: some seconds; else some queries are timed
};

/// In three modes, on radii that are graded 1:100 and of the points given with one in a hundred four times as
/// large: ours; the largest radius for all, filtered afterwards; uniform searches of each octave; K nearest
/// without regard for radii, K being the mean length of a list; and peers that have radii of queries.
/// @throws Cancelled, and InputError of the truth
std::vector<SetResult> studyRadii(const BenchPoints& points, const SetStudyOptions& options,
                                  const ProgressSpan& span);

/// The nearest 1, 8 and 32 within the radius: ours; full lists as they are; full lists sorted and cut
/// afterwards; and of a peer K nearest without regard for the radius, and those within it.
/// @throws as above
std::vector<SetResult> studyNearest(const BenchPoints& points, const SetStudyOptions& options,
                                    const ProgressSpan& span);

} // namespace vdb_nns::cli
