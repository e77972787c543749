#include "bench/stability/trial_check.h"

#include "bench/accuracy.h"
#include "bench/truth.h"
#include "numbers.h"

#include <algorithm>
#include <iterator>
#include <stdexcept>

namespace vdb_nns::cli {
namespace {

constexpr std::uint64_t kMostEntries = 4'000'000; // of the rows that are read one by one

std::vector<std::uint32_t> knownRow(KnownRows known, std::uint32_t query, std::uint32_t particles)
{
    std::vector<std::uint32_t> row;
    if (known == KnownRows::kTwin && (query ^ 1) < particles) row.push_back(query ^ 1);
    if (known == KnownRows::kAllOthers) {
        row.reserve(particles);
        for (std::uint32_t j = 0; j < particles; ++j) {
            if (j != query) row.push_back(j);
        }
    }
    return row;
}

std::uint64_t knownCount(KnownRows known, std::uint64_t particles)
{
    return known == KnownRows::kAllOthers ? particles - 1 : known == KnownRows::kTwin ? 1 : 0;
}

void compareCounts(std::uint64_t found, std::uint64_t expected, TrialCheck& check)
{
    check.missing += expected - std::min(expected, found);
    check.extra += found - std::min(expected, found);
}

void compareRows(std::vector<std::uint32_t>& found, const std::vector<std::uint32_t>& expected,
                 TrialCheck& check)
{
    std::sort(found.begin(), found.end());
    const auto unique = std::unique(found.begin(), found.end());
    check.duplicates += static_cast<std::uint64_t>(found.end() - unique);
    found.erase(unique, found.end());
    std::vector<std::uint32_t> common;
    std::set_intersection(found.begin(), found.end(), expected.begin(), expected.end(),
                          std::back_inserter(common));
    check.missing += expected.size() - common.size();
    check.extra += found.size() - common.size();
}

// Every row where that is little, else some at equal distances; of the other queries the counts.
void checkKnown(const FoundNeighbors& found, std::uint32_t particles, KnownRows known, TrialCheck& check)
{
    if (particles == 0) return;
    const std::uint64_t expected = knownCount(known, particles);
    const std::uint64_t rows = std::clamp<std::uint64_t>(kMostEntries / (expected + 1), 1, particles);
    const std::uint64_t step = (particles + rows - 1) / rows;
    std::vector<std::uint32_t> row;
    for (std::uint32_t query = 0; query < particles; ++query) {
        if (!found.hasRows() || query % step != 0) {
            compareCounts(found.count(query), expected, check);
            continue;
        }
        found.row(query, row);
        if (row.size() != found.count(query)) check.message = "counts differ from rows";
        compareRows(row, knownRow(known, query, particles), check);
    }
}

// The sum of all pairs, and whether all of them are of particles.
void sumPairs(const FoundNeighbors& found, std::uint32_t particles, const std::vector<std::uint32_t>& order,
              TrialCheck& check)
{
    const auto numberOf = [&order](std::uint32_t i) {
        return static_cast<std::uint64_t>(order.empty() ? i : order[i]);
    };
    std::vector<std::uint32_t> row;
    std::uint64_t strangers = 0;
    for (std::uint32_t query = 0; query < particles; ++query) {
        const std::uint64_t base = numberOf(query) << 32;
        if (!found.hasRows()) {
            check.pairSum += mix64(base + found.count(query));
            continue;
        }
        found.row(query, row);
        for (const std::uint32_t neighbor : row) {
            if (neighbor < particles) {
                check.pairSum += mix64(base + numberOf(neighbor));
            } else {
                ++strangers;
            }
        }
    }
    check.hasStrangers = strangers > 0;
    if (!check.hasStrangers) return;
    check.extra += strangers;
    check.message = "listed numbers that no particle has";
}

void checkSets(const FoundNeighbors& found, const SetSearch& search, TrialCheck& check)
{
    const Truth truth = findTruth(search, {});
    if (!truth.complete) throw std::logic_error("a case of --stability is too large for its whole truth");
    const WrongPairs wrong = findWrongPairs(found, truth);
    check.missing = wrong.missing;
    check.extra = wrong.extra;
    check.duplicates = wrong.duplicates;
    if (!found.hasRows()) return;
    std::vector<std::uint32_t> row;
    for (const std::uint32_t query : truth.queries) {
        found.row(query, row);
        if (row.size() != found.count(query)) {
            check.message = "counts differ from rows";
            ++check.extra;
        }
    }
}

} // namespace

TrialCheck checkFound(const FoundNeighbors& found, const CaseParticles& particles,
                      const std::vector<std::uint32_t>& order)
{
    TrialCheck check;
    if (particles.search) {
        checkSets(found, *particles.search, check);
        return check;
    }
    const auto count = static_cast<std::uint32_t>(particles.view.size());
    if (particles.known != KnownRows::kUnknown) {
        checkKnown(found, count, particles.known, check);
        return check;
    }
    sumPairs(found, count, order, check);
    if (check.hasStrangers) return check;
    const Truth truth = findTruth(particles.view, particles.radius, {});
    if (!truth.complete) throw std::logic_error("a case of --stability is too large for its whole truth");
    const AccuracyReport report = checkAccuracy(found, particles.view, particles.radius, truth);
    check.missing = report.missing;
    check.extra = report.extra;
    check.duplicates = report.duplicates;
    check.asymmetric = report.asymmetric;
    return check;
}

} // namespace vdb_nns::cli
