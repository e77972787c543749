// `vdb_nns verify`: checks neighbor lists against a search of its own. Shares no grid, filter or kernel with the engine:
// hash cells (radius_classes.h), double arithmetic with a certified bound (search_clouds.h), exact integers inside it
// (exact_pair.h).
#pragma once

#include "lists_reader.h"
#include "search_judge.h"
#include "vdb_nns/particle_view.h"
#include "vdb_nns/progress.h"

#include <array>
#include <cstdint>
#include <optional>
#include <vector>

namespace vdb_nns::cli {

struct VerifyOptions {
    std::optional<std::uint64_t>
        sample;                   // check this many seeded queries against all points; empty: all, by cells
    std::uint64_t seed = 1;       // of the sample
    std::size_t maxExamples = 10; // of each kind
};

enum class Fault { kMissing, kExtra, kSelf, kDuplicate, kUnsorted, kOutOfRange, kWrongDistance };
constexpr std::size_t kFaultKinds = 7;

// "missing", "extra", "self", "duplicate", "unsorted", "out of range", "wrong distance".
const char* faultName(Fault fault);

struct FaultExample {
    std::uint64_t query;
    std::int64_t neighbor; // as in the file
    double distance = 0;   // world units; NaN if one of the two is not finite or does not exist
    double ulps = 0;       // (distance - radius) in ulps of the radius; NaN likewise
    float fileValue = 0;   // what `data` holds: for kWrongDistance
};

struct FaultFinding {
    std::uint64_t count = 0;
    std::vector<FaultExample> examples; // the first by query and neighbor
};

struct VerifyReport {
    std::uint64_t queries = 0;       // rows checked
    std::uint64_t listedPairs = 0;   // entries of those rows
    std::uint64_t expectedPairs = 0; // what they should hold together
    std::uint64_t exactPairs = 0;    // tests that needed exact arithmetic
    std::array<FaultFinding, kFaultKinds> findings;

    const FaultFinding& finding(Fault fault) const { return findings[static_cast<std::size_t>(fault)]; }
    std::uint64_t faultCount() const;
    bool passed() const { return faultCount() == 0; }
};

// Checks every row (or a sample): the neighbors are those of the definition, ascending by number or by distance, none twice,
// none the query itself unless that is asked for; of true neighbors, a connectivity holds ones and distances are the float
// nearest to the true distance (or its neighbor where double arithmetic cannot tell). Points that are not finite, or not of
// the groups chosen, have empty rows and are in none. The report is the same for any number of threads.
// An entry out of range, equal to the query or repeated counts as that alone; other entries that should not be there are
// extra. An entry smaller than the one before it is unsorted, besides; where rows are by distance, one of those that should
// be there which should stand before the last of them.
// @throws InputError if the lists have another shape than the sets, InvalidInput for a radius of all pairs that is not
//         positive and finite and for radii that are not as many as the particles, Cancelled
VerifyReport verifyLists(const SearchTerms& terms, const ListsFile& lists, const VerifyOptions& options = {},
                         Progress* progress = nullptr);

// The same of all particles of one set within one radius.
VerifyReport verifyLists(const ParticleView& view, double radius, const ListsFile& lists,
                         const VerifyOptions& options = {}, Progress* progress = nullptr);

} // namespace vdb_nns::cli
