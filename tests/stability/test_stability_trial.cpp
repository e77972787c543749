// The runner of stability trials says truly how a method fails, whatever it does to its process.
#include "bench/stability/matrix.h"
#include "bench/truth.h"
#include "signals.h"
#include "vdb_nns/error.h"
#include "vdb_nns/measure.h"
#include "vdb_nns/search.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <csignal>
#include <cstdlib>
#include <functional>
#include <iostream>
#include <limits>
#include <list>
#include <memory>
#include <stdexcept>
#include <string>
#include <sys/wait.h>
#include <unistd.h>
#include <utility>
#include <vector>

namespace vdb_nns::cli {
namespace {

class Double : public MethodWithResult {
public:
    using Run = std::function<std::unique_ptr<FoundNeighbors>(const ParticleView&, double)>;
    explicit Double(Run run) : mRun(std::move(run)) {}

    MethodRun run(const ParticleView& view, double radius, const ProgressSpan&) override
    {
        mFound = mRun(view, radius);
        return {};
    }

private:
    Run mRun;
};

class DoubleOfSets : public MethodWithResult {
public:
    using Run = std::function<std::unique_ptr<FoundNeighbors>(const SetSearch&)>;
    explicit DoubleOfSets(Run run) : mRun(std::move(run)) {}

    MethodRun run(const ParticleView& view, double radius, const ProgressSpan& span) override
    {
        return runSets({view, radius}, span);
    }
    MethodRun runSets(const SetSearch& search, const ProgressSpan&) override
    {
        mFound = mRun(search);
        return {};
    }

private:
    Run mRun;
};

// Measures as the engine makes them, and then spoilt.
class DoubleOfMeasures : public MethodWithResult {
public:
    using Spoil = std::function<void(Measured&)>;
    explicit DoubleOfMeasures(Spoil spoil) : mSpoil(std::move(spoil)) {}

    MethodRun run(const ParticleView&, double, const ProgressSpan&) override
    {
        throw std::logic_error("measures are asked for");
    }
    Measured measure(const SetSearch& search, const std::vector<std::string>& names,
                     const MeasureOptions& options, const ProgressSpan&) override
    {
        MeasureOptions own = options;
        own.search.nearest = search.nearest;
        SearchEngine engine;
        Measured made =
            engine.measure(engine.sort(search.candidates, search.queries, search.radius), names, own);
        mSpoil(made);
        return made;
    }

private:
    Spoil mSpoil;
};

StabilityTrial trialOfMeasures(const char* caseName, const DoubleOfMeasures::Spoil& spoil)
{
    MethodSpec spec;
    spec.name = "double";
    spec.kind = MethodKind::kEngine;
    return runTrial(stabilityCases({caseName}).front(), spec, {}, [&](const MethodSpec&, const MethodSetup&) {
        return std::make_unique<DoubleOfMeasures>(spoil);
    });
}

// The numbers of an attribute, to be spoilt.
template <typename Number>
Number* numbersOf(const Measured& made, const std::string& name)
{
    for (const PointAttribute& attribute : made.values.attributes) {
        if (attribute.name == name)
            return static_cast<Number*>(std::const_pointer_cast<void>(attribute.values).get());
    }
    throw std::logic_error("there is no " + name);
}

// A trial of a method that does that.
StabilityTrial trialOf(const Double::Run& run, double seconds = 30, const char* caseName = "twice",
                       MethodKind kind = MethodKind::kPeer)
{
    MethodSpec spec;
    spec.name = "double";
    spec.kind = kind;
    TrialLimits limits;
    limits.seconds = seconds;
    limits.bytes = std::uint64_t(512) << 20;
    return runTrial(stabilityCases({caseName}).front(), spec, limits,
                    [&](const MethodSpec&, const MethodSetup&) { return std::make_unique<Double>(run); });
}

// The true rows, to be spoilt.
std::unique_ptr<RowBuffers> trueRows(const ParticleView& view, double radius)
{
    const Truth truth = findTruth(view, radius, {});
    auto rows = std::make_unique<RowBuffers>();
    rows->places.resize(view.size());
    rows->buffers.resize(view.size());
    for (std::size_t k = 0; k < truth.queries.size(); ++k) {
        const Span<const std::uint32_t> row = truth.row(k);
        rows->places[truth.queries[k]] = {0, static_cast<std::uint32_t>(row.size()), truth.queries[k]};
        rows->buffers[truth.queries[k]].assign(row.begin(), row.end());
    }
    return rows;
}

void setRow(RowBuffers& rows, std::uint32_t query, const std::vector<std::uint32_t>& row)
{
    rows.buffers[query] = row;
    rows.places[query].count = static_cast<std::uint32_t>(row.size());
}

StabilityTrial trialOfSets(const char* caseName, const DoubleOfSets::Run& run)
{
    MethodSpec spec;
    spec.name = "double";
    spec.family = "brute-force"; // which has every search
    spec.kind = MethodKind::kPeer;
    return runTrial(stabilityCases({caseName}).front(), spec, {}, [&](const MethodSpec&, const MethodSetup&) {
        return std::make_unique<DoubleOfSets>(run);
    });
}

std::unique_ptr<RowBuffers> rowsOf(const Truth& truth)
{
    auto rows = std::make_unique<RowBuffers>();
    rows->places.resize(truth.queries.size());
    rows->buffers.resize(truth.queries.size());
    for (std::size_t k = 0; k < truth.queries.size(); ++k) {
        const Span<const std::uint32_t> row = truth.row(k);
        rows->places[k] = {0, static_cast<std::uint32_t>(row.size()), static_cast<std::uint32_t>(k)};
        rows->buffers[k].assign(row.begin(), row.end());
    }
    return rows;
}

TEST(StabilityTrial, SetsThatAreRightAreExact)
{
    for (const char* name :
         {"radii-bad-symmetric", "radii-1e4-scatter", "sets-on-top", "groups-no-query", "nearest-equal"}) {
        const StabilityTrial trial =
            trialOfSets(name, [](const SetSearch& search) { return rowsOf(findTruth(search, {})); });
        EXPECT_EQ(trial.verdict, Verdict::kExact) << name << ": " << trial.message;
    }
}

TEST(StabilityTrial, WrongPairsOfSetsAreCounted)
{
    // The ninth in place of one of eight.
    StabilityTrial trial = trialOfSets("nearest-equal", [](const SetSearch& search) {
        auto rows = rowsOf(findTruth(search, {}));
        SetSearch more = search;
        ++more.nearest;
        const std::vector<std::uint32_t> kept = rows->buffers[700];
        std::vector<std::uint32_t> row = kept;
        const Truth longer = findTruth(more, {});
        for (const std::uint32_t number : longer.row(700)) {
            if (!std::binary_search(kept.begin(), kept.end(), number)) row.back() = number;
        }
        setRow(*rows, 700, row);
        return rows;
    });
    EXPECT_EQ(trial.verdict, Verdict::kWrong);
    EXPECT_EQ(trial.missing, 1u);
    EXPECT_EQ(trial.extra, 1u);
    // Itself, and one twice.
    trial = trialOfSets("groups-same", [](const SetSearch& search) {
        auto rows = rowsOf(findTruth(search, {}));
        std::vector<std::uint32_t> row = rows->buffers[602];
        row.push_back(602);
        row.push_back(row.front());
        setRow(*rows, 602, row);
        return rows;
    });
    EXPECT_EQ(trial.verdict, Verdict::kWrong);
    EXPECT_EQ(trial.missing, 0u);
    EXPECT_EQ(trial.extra, 1u);
    EXPECT_EQ(trial.duplicates, 1u);
    // A pair where nobody asks.
    trial = trialOfSets("groups-no-query", [](const SetSearch& search) {
        auto rows = rowsOf(findTruth(search, {}));
        setRow(*rows, 5, {4, 6});
        return rows;
    });
    EXPECT_EQ(trial.extra, 2u);
    // Counts alone.
    trial = trialOfSets("sets-overlap", [](const SetSearch& search) {
        const auto rows = rowsOf(findTruth(search, {}));
        std::vector<std::uint32_t> counts;
        for (std::uint32_t i = 0; i < rows->places.size(); ++i)
            counts.push_back(static_cast<std::uint32_t>(rows->count(i)));
        counts[0] += 3;
        return std::make_unique<CountedNeighbors>(counts);
    });
    EXPECT_EQ(trial.verdict, Verdict::kWrong);
    EXPECT_EQ(trial.extra, 3u);
}

TEST(StabilityTrial, MeasuresThatAreRightAreExact)
{
    for (const char* name : {"measures-two", "measures-radii-bad-scatter", "measures-nearest-coincident",
                             "measures-groups-no-query", "measures-values-some-nan"}) {
        const StabilityTrial trial = trialOfMeasures(name, [](Measured&) {});
        EXPECT_EQ(trial.verdict, Verdict::kExact) << name << ": " << trial.message;
        EXPECT_EQ(trial.wrongValues, 0u);
    }
}

TEST(StabilityTrial, WrongMeasuresAreCounted)
{
    constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
    constexpr double kInfinity = std::numeric_limits<double>::infinity();
    struct Wrong {
        const char* says; // begins the message
        DoubleOfMeasures::Spoil spoil;
    };
    const std::size_t i = 300; // a particle inside the block
    const std::vector<Wrong> all = {
        {"density", [=](Measured& m) { numbersOf<float>(m, "density")[i] = kNan; }},
        {"density", [=](Measured& m) { numbersOf<float>(m, "density")[i] *= 1.00001f; }},
        {"count", [=](Measured& m) { ++numbersOf<std::int32_t>(m, "count")[i]; }},
        {"mean_distance", [=](Measured& m) { numbersOf<float>(m, "mean_distance")[i] = 0; }},
        {"nearest_distance", [=](Measured& m) { numbersOf<float>(m, "nearest_distance")[i] = -1; }},
        {"nearest", [=](Measured& m) { numbersOf<std::int32_t>(m, "nearest")[i] = 300; }},
        {"average:d", [=](Measured& m) { numbersOf<double>(m, "average:d")[i] *= 1 + 1e-12; }},
        {"average:v", [=](Measured& m) { numbersOf<float>(m, "average:v")[3 * i + 1] = kNan; }},
        {"normal",
         [=](Measured& m) {
             for (std::size_t k = 0; k < 3; ++k) numbersOf<float>(m, "normal")[3 * i + k] *= 2;
         }},
        {"eigenvalues", [=](Measured& m) { numbersOf<float>(m, "eigenvalues")[3 * i + 2] *= -1; }},
        {"stretch", [=](Measured& m) { numbersOf<float>(m, "stretch")[3 * i] *= 1.001f; }},
        {"xform", [=](Measured& m) { numbersOf<float>(m, "xform")[9 * i] += 0.001f; }},
        {"pws", [=](Measured& m) { numbersOf<double>(m, "pws")[3 * i] = kInfinity; }},
        {"cluster", [=](Measured& m) { ++numbersOf<std::int32_t>(m, "cluster")[i]; }},
        {"cluster_size", [=](Measured& m) { --numbersOf<std::int32_t>(m, "cluster_size")[i]; }},
        {"isolated",
         [=](Measured& m) {
             std::const_pointer_cast<std::uint8_t>(m.values.groups[1].members).get()[i] = 1;
         }},
        {"bench: has no attribute 'density'",
         [](Measured& m) { m.values.attributes.erase(m.values.attributes.begin() + 1); }},
        {"values skipped of 'w'", [](Measured& m) {
             m.skipped.push_back({"w", 1});
         }}};
    for (const Wrong& wrong : all) {
        const StabilityTrial trial = trialOfMeasures("measures-mass-some-0", wrong.spoil);
        EXPECT_EQ(trial.verdict, Verdict::kWrong) << wrong.says;
        EXPECT_GE(trial.wrongValues, 4u) << wrong.says; // one of each pass
        EXPECT_EQ(trial.message.compare(0, std::string(wrong.says).size(), wrong.says), 0) << trial.message;
        EXPECT_FALSE(oursHolds(trial));
    }
}

// What the independent check leaves open, for want of digits, are ranges and agreement with each other.
TEST(StabilityTrial, MeasuresWithoutAReferenceAreInTheirRange)
{
    const auto expectWrong = [](const char* caseName, const char* says,
                                const DoubleOfMeasures::Spoil& spoil) {
        const StabilityTrial trial = trialOfMeasures(caseName, spoil);
        EXPECT_EQ(trial.verdict, Verdict::kWrong) << says;
        EXPECT_NE(trial.message.find(says), std::string::npos) << trial.message;
    };
    // The sum of the weights is 0 but for one kernel.
    expectWrong("measures-at-radius", "average:f is 1e+06",
                [](Measured& m) { numbersOf<float>(m, "average:f")[3] = 1e6f; });
    expectWrong("measures-at-radius", "eigenvalues is -1",
                [](Measured& m) { numbersOf<float>(m, "eigenvalues")[3] = -1; });
    // The normal of a particle inside a lattice is a rounding, or 0.
    expectWrong("measures-sheet", "normal",
                [](Measured& m) { numbersOf<float>(m, "normal")[3 * 450] = 0.5f; });
}

TEST(StabilityTrial, OtherMeasuresFromRunToRunAreWrong)
{
    int passes = 0;
    const StabilityTrial trial = trialOfMeasures("measures-two", [&passes](Measured& m) {
        float& density = numbersOf<float>(m, "average:i")[0]; // within its bound, but another byte
        if (passes++ == 5) density = std::nextafter(density, 0.0f);
    });
    EXPECT_EQ(trial.verdict, Verdict::kWrong);
    EXPECT_NE(trial.message.find("without SIMD"), std::string::npos) << trial.message;
}

TEST(StabilityTrial, OtherPairsInAMirrorAreWrong)
{
    int runs = 0;
    const auto losesInRun = [&runs](int wrong) {
        return [&runs, wrong](const ParticleView& view, double radius) {
            auto rows = trueRows(view, radius);
            if (runs++ == wrong) setRow(*rows, 3, {});
            return rows;
        };
    };
    EXPECT_EQ(trialOf(losesInRun(9), 30, "negative").verdict, Verdict::kExact); // of three runs none
    for (const int run : {1, 2}) {
        runs = 0;
        const StabilityTrial trial = trialOf(losesInRun(run), 30, "mirror-ties");
        EXPECT_EQ(trial.verdict, Verdict::kWrong);
        EXPECT_GT(trial.missing, 0u);
        EXPECT_NE(trial.message.find("mirrored"), std::string::npos) << trial.message;
    }
}

TEST(StabilityTrial, OneThatIsRightIsExact)
{
    const StabilityTrial trial = trialOf(trueRows);
    EXPECT_EQ(trial.verdict, Verdict::kExact) << trial.message;
    EXPECT_EQ(trial.missing + trial.extra + trial.duplicates, 0u);
    EXPECT_EQ(trial.asymmetric, 0u);
    EXPECT_GT(trial.seconds, 0);
    EXPECT_LT(trial.seconds, 30);
    EXPECT_GT(trial.peakBytes, 100'000u);
    EXPECT_EQ(trial.caseName, "twice");
    EXPECT_EQ(trial.group, "duplicates");
    EXPECT_EQ(trial.method, "double");
}

TEST(StabilityTrial, WrongPairsAreCounted)
{
    const StabilityTrial trial = trialOf([](const ParticleView& view, double radius) {
        auto rows = trueRows(view, radius);
        for (std::uint32_t query = 0; query < 7; ++query) { // 7 missing
            std::vector<std::uint32_t> row = rows->buffers[query];
            row.pop_back();
            setRow(*rows, query, row);
        }
        for (std::uint32_t query = 100; query < 103;
             ++query) { // 3 extra: the last particle is at another corner
            std::vector<std::uint32_t> row = rows->buffers[query];
            row.push_back(static_cast<std::uint32_t>(view.size() - 1));
            setRow(*rows, query, row);
        }
        std::vector<std::uint32_t> row = rows->buffers[200]; // 2 twice
        row.insert(row.end(), {row[0], row[1]});
        setRow(*rows, 200, row);
        return rows;
    });
    EXPECT_EQ(trial.verdict, Verdict::kWrong);
    EXPECT_EQ(trial.missing, 7u);
    EXPECT_EQ(trial.extra, 3u);
    EXPECT_EQ(trial.duplicates, 2u);
    ASSERT_TRUE(trial.asymmetric.has_value());
    EXPECT_EQ(*trial.asymmetric, 10u);
}

TEST(StabilityTrial, WrongCountsAreCounted)
{
    const StabilityTrial trial = trialOf([](const ParticleView& view, double radius) {
        const auto rows = trueRows(view, radius);
        std::vector<std::uint32_t> counts;
        for (std::uint32_t i = 0; i < view.size(); ++i)
            counts.push_back(static_cast<std::uint32_t>(rows->count(i)));
        counts[3] += 4;
        counts[5] -= 2;
        return std::make_unique<CountedNeighbors>(counts);
    });
    EXPECT_EQ(trial.verdict, Verdict::kWrong);
    EXPECT_EQ(trial.missing, 2u);
    EXPECT_EQ(trial.extra, 4u);
    EXPECT_FALSE(trial.asymmetric.has_value());
}

// Where rows are known: of all particles at one point.
TEST(StabilityTrial, KnownRowsAreChecked)
{
    const auto spoilt = [](int lost) {
        return [lost](const ParticleView& view, double radius) {
            auto rows = trueRows(view, radius);
            std::vector<std::uint32_t> row = rows->buffers[1];
            row.resize(row.size() - static_cast<std::size_t>(lost));
            setRow(*rows, 1, row);
            return rows;
        };
    };
    EXPECT_EQ(trialOf(spoilt(0), 30, "coincident").verdict, Verdict::kExact);
    const StabilityTrial trial = trialOf(spoilt(9), 30, "coincident");
    EXPECT_EQ(trial.verdict, Verdict::kWrong);
    EXPECT_EQ(trial.missing, 9u);
}

TEST(StabilityTrial, NumbersThatNoParticleHasAreWrongAndReadNothing)
{
    const StabilityTrial trial = trialOf([](const ParticleView& view, double radius) {
        auto rows = trueRows(view, radius);
        setRow(*rows, 4, {0, 4'000'000'000u});
        return rows;
    });
    EXPECT_EQ(trial.verdict, Verdict::kWrong);
    EXPECT_EQ(trial.extra, 1u);
    EXPECT_NE(trial.message.find("no particle"), std::string::npos);
}

TEST(StabilityTrial, OtherPairsInAnotherOrderAreWrong)
{
    int runs = 0;
    const StabilityTrial trial = trialOf(
        [&runs](const ParticleView& view, double radius) {
            auto rows = trueRows(view, radius);
            if (runs++ == 1) setRow(*rows, 0, {});
            return rows;
        },
        30, "shuffled");
    EXPECT_EQ(trial.verdict, Verdict::kWrong);
    EXPECT_GT(trial.missing, 0u);
    EXPECT_NE(trial.message.find("another order"), std::string::npos) << trial.message;
}

TEST(StabilityTrial, AbortIsACrashWithItsLastWords)
{
    const StabilityTrial trial = trialOf([](const ParticleView&, double) -> std::unique_ptr<FoundNeighbors> {
        std::cerr << "first words\nassertion that: failed" << std::endl;
        std::abort();
    });
    EXPECT_EQ(trial.verdict, Verdict::kCrash);
    EXPECT_EQ(trial.message, "SIGABRT: assertion that: failed");
}

TEST(StabilityTrial, ASegmentationFaultIsACrash)
{
    const StabilityTrial trial = trialOf([](const ParticleView&, double) -> std::unique_ptr<FoundNeighbors> {
        std::raise(SIGSEGV);
        return nullptr;
    });
    EXPECT_EQ(trial.verdict, Verdict::kCrash);
    EXPECT_EQ(trial.message, "SIGSEGV");
}

TEST(StabilityTrial, ExitIsACrash)
{
    const StabilityTrial trial =
        trialOf([](const ParticleView&, double) -> std::unique_ptr<FoundNeighbors> { std::exit(-1); });
    EXPECT_EQ(trial.verdict, Verdict::kCrash);
    EXPECT_EQ(trial.message, "ended the program with status 255");
}

// Not even with a status that says that all is well.
TEST(StabilityTrial, ExitWithNoughtIsACrash)
{
    const StabilityTrial trial =
        trialOf([](const ParticleView&, double) -> std::unique_ptr<FoundNeighbors> { _exit(0); });
    EXPECT_EQ(trial.verdict, Verdict::kCrash);
    EXPECT_EQ(trial.message, "ended the program with status 0");
}

TEST(StabilityTrial, OneThatSleepsHangs)
{
    const StabilityTrial trial = trialOf(
        [](const ParticleView&, double) -> std::unique_ptr<FoundNeighbors> {
            for (;;) pause();
        },
        0.3);
    EXPECT_EQ(trial.verdict, Verdict::kHang);
    EXPECT_GE(trial.seconds, 0.3);
    EXPECT_LT(trial.seconds, 10);
}

// SIGTERM, a full pipe of words and a closed stderr are no way around the deadline.
TEST(StabilityTrial, OneThatTalksForEverHangs)
{
    const StabilityTrial trial = trialOf(
        [](const ParticleView&, double) -> std::unique_ptr<FoundNeighbors> {
            std::signal(SIGTERM, SIG_IGN);
            for (int k = 0;; ++k) {
                std::cerr << "still at it\n";
                if (k == 100'000) close(STDERR_FILENO);
            }
        },
        0.5);
    EXPECT_EQ(trial.verdict, Verdict::kHang);
}

TEST(StabilityTrial, MemoryWithoutEndIsRefusedByTheLimit)
{
    const StabilityTrial trial = trialOf([](const ParticleView&, double) -> std::unique_ptr<FoundNeighbors> {
        std::list<std::vector<char>> all;
        for (;;) all.emplace_back(10 << 20, 'x');
    });
    EXPECT_EQ(trial.verdict, Verdict::kMemory);
    EXPECT_GT(trial.peakBytes, 200u << 20);
    EXPECT_LT(trial.peakBytes, 4096ull << 20) << "512 MiB, and 80 MiB for each thread";
}

TEST(StabilityTrial, ARefusalIsTold)
{
    const auto refuse = [](const ParticleView&, double) -> std::unique_ptr<FoundNeighbors> {
        throw InvalidInput("no such radius");
    };
    StabilityTrial trial = trialOf(refuse);
    EXPECT_EQ(trial.verdict, Verdict::kRefused);
    EXPECT_EQ(trial.message, "no such radius");
    EXPECT_TRUE(oursHolds(trial)) << "a peer may";
    trial = trialOf(refuse, 30, "twice", MethodKind::kEngine);
    EXPECT_EQ(trial.verdict, Verdict::kRefused);
    EXPECT_FALSE(oursHolds(trial)) << "an answer is due";
    trial = trialOf(refuse, 30, "radius-0", MethodKind::kEngine);
    EXPECT_FALSE(trial.isClear);
    EXPECT_FALSE(oursHolds(trial)) << "a refusal is due, but a clear one";
}

TEST(StabilityTrial, OursPromisesItsExceptions)
{
    const auto fail = [](const ParticleView&, double) -> std::unique_ptr<FoundNeighbors> {
        throw std::out_of_range("vector::at");
    };
    EXPECT_EQ(trialOf(fail).verdict, Verdict::kRefused) << "of a peer";
    const StabilityTrial trial = trialOf(fail, 30, "twice", MethodKind::kEngine);
    EXPECT_EQ(trial.verdict, Verdict::kCrash);
    EXPECT_FALSE(oursHolds(trial));
}

// An answer to a radius that is none does not do, even one that is right by the letter.
TEST(StabilityTrial, WhereARefusalIsDueAnAnswerFails)
{
    const auto nobody = [](const ParticleView& view, double) {
        return std::make_unique<CountedNeighbors>(std::vector<std::uint32_t>(view.size()));
    };
    const StabilityTrial trial = trialOf(nobody, 30, "radius-nan", MethodKind::kEngine);
    EXPECT_EQ(trial.verdict, Verdict::kExact);
    EXPECT_FALSE(oursHolds(trial));
}

// In a process of its own, as a signal that came is remembered. Its exit status is 0 if it was cancelled and its child is gone.
TEST(StabilityTrial, SigintEndsTheChildToo)
{
    const pid_t pid = fork();
    ASSERT_GE(pid, 0);
    if (pid == 0) {
        installSignalHandlers();
        try {
            trialOf([](const ParticleView&, double) -> std::unique_ptr<FoundNeighbors> {
                kill(getppid(), SIGINT);
                for (;;) pause();
            });
        } catch (const Cancelled&) {
            _exit(waitpid(-1, nullptr, WNOHANG) == -1 && errno == ECHILD ? 0 : 2);
        }
        _exit(1);
    }
    int status = 0;
    ASSERT_EQ(waitpid(pid, &status, 0), pid);
    EXPECT_TRUE(WIFEXITED(status));
    EXPECT_EQ(WEXITSTATUS(status), 0);
}

} // namespace
} // namespace vdb_nns::cli
