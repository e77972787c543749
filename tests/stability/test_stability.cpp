// The engine answers exactly, or refuses clearly where that is right, in every trial of the stability matrix.
#include "bench/stability/matrix.h"
#include "vdb_nns/error.h"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include <cctype>
#include <ostream>
#include <set>

namespace vdb_nns::cli {

// For messages of GoogleTest.
static std::ostream& operator<<(std::ostream& out, Verdict verdict)
{
    return out << verdictName(verdict);
}

namespace {

// ---- the engine ------------------------------------------------------------------------------------------------------

struct TrialName {
    std::size_t number = 0; // of the case
    MethodSpec spec;
};

// For messages of GoogleTest.
std::ostream& operator<<(std::ostream& out, const TrialName& name)
{
    return out << stabilityCases()[name.number].name << " with " << name.spec.name;
}

bool isOfSets(const StabilityCase& stabilityCase)
{
    const std::string& group = stabilityCase.group;
    return group == "radii" || group == "sets" || group == "nearest";
}

// Devices search one set, the nearest are not held as masks, and measures are the CPU's: such trials are skipped, and that is
// tested below.
bool isAbout(const StabilityCase& stabilityCase, const MethodSpec& spec)
{
    if (stabilityCase.condition.isForDevices()) return spec.hasBudget();
    if (stabilityCase.group == "measures") { // not made: views of grids start threads
        SetSearch search;
        search.nearest = stabilityCase.name.find("nearest") != std::string::npos ? 1 : 0;
        return missingMeasures(spec, search).empty();
    }
    return !isOfSets(stabilityCase) || missingSearch(spec, *stabilityCase.make().search).empty();
}

std::vector<TrialName> trialsOfOurs()
{
    std::vector<TrialName> trials;
    for (std::size_t c = 0; c < stabilityCases().size(); ++c) {
        for (const MethodSpec& spec : stabilityMethods()) {
            if (spec.isExact() && isAbout(stabilityCases()[c], spec)) trials.push_back({c, spec});
        }
    }
    return trials;
}

std::string testName(const ::testing::TestParamInfo<TrialName>& info)
{
    std::string name = stabilityCases()[info.param.number].name + "_" + info.param.spec.name;
    for (char& c : name) {
        if (!std::isalnum(static_cast<unsigned char>(c))) c = '_';
    }
    return name;
}

class Ours : public ::testing::TestWithParam<TrialName> {};

TEST_P(Ours, KeepsItsWord)
{
    const StabilityCase& stabilityCase = stabilityCases()[GetParam().number];
    TrialLimits limits;
    limits.seconds = 120; // a sanity bound: machines of CI are slow and shared
    const StabilityTrial trial = runTrial(stabilityCase, GetParam().spec, limits);
    EXPECT_TRUE(oursHolds(trial)) << trial.caseName << " (" << trial.what << ") with " << trial.method
                                  << " is " << trial.verdict << ": " << trial.missing << " missing, "
                                  << trial.extra << " extra, " << trial.duplicates << " twice, "
                                  << trial.wrongValues << " wrong values; " << trial.message;
    EXPECT_NE(trial.verdict, Verdict::kSkipped) << trial.message;
}

INSTANTIATE_TEST_SUITE_P(Stability, Ours, ::testing::ValuesIn(trialsOfOurs()), testName);

// ---- the cases -------------------------------------------------------------------------------------------------------

TEST(StabilityCases, EveryFailureThatIsKnownHasSome)
{
    std::set<std::string> groups, names;
    for (const StabilityCase& c : stabilityCases()) {
        groups.insert(c.group);
        EXPECT_TRUE(names.insert(c.name).second) << c.name << " twice";
        EXPECT_FALSE(c.what.empty()) << c.name;
    }
    // In the order of notes on demand, part 2.
    for (const char* group :
         {"clusters", "offset", "ties",   "pairs",      "seams",      "non-finite", "duplicates", "sparse",
          "devices",  "few",    "radius", "bad radius", "transforms", "codecs",     "order",      "threads",
          "memory",   "scale",  "thin",   "radii",      "sets",       "nearest",    "measures"}) {
        EXPECT_EQ(groups.erase(group), 1u) << group;
    }
    EXPECT_TRUE(groups.empty()) << *groups.begin();
}

TEST(StabilityCases, AreChosenByNameOrGroup)
{
    EXPECT_EQ(stabilityCases(std::vector<std::string>{}).size(), stabilityCases().size());
    EXPECT_EQ(stabilityCases({"tie-0.1"}).size(), 1u);
    EXPECT_EQ(stabilityCases({"bad radius", "radius-0"}).size(), 4u);
    EXPECT_THROW(stabilityCases({"tie-0.1", "no-such"}), InvalidInput);
}

// Every kind of search is there, and the engine on the CPU is asked for each of them.
TEST(StabilityCases, OfSetsHaveASearchThatTheEngineHas)
{
    std::set<RadiusMode> modes;
    std::size_t apart = 0, nearest = 0;
    for (const StabilityCase& c : stabilityCases()) {
        if (!isOfSets(c)) continue;
        SCOPED_TRACE(c.name);
        const CaseParticles particles = c.make();
        ASSERT_TRUE(particles.search);
        const SetSearch& search = *particles.search;
        EXPECT_FALSE(search.isPlain());
        for (const char* name : {"ours-index", "ours-count", "ours-visit", "brute-force"})
            EXPECT_EQ(missingSearch(parseMethod(name), search), "");
        EXPECT_EQ(missingSearch(parseMethod("ours-mask"), search).empty(), search.nearest == 0);
        for (const char* name : {"blocks-index", "both-auto-index", "world-double"})
            EXPECT_NE(missingSearch(parseMethod(name), search), "") << name;
        if (!search.radius.isOne()) modes.insert(search.radius.mode);
        apart += !search.isOneSet();
        nearest += search.nearest > 0;
    }
    EXPECT_EQ(modes.size(), 3u);
    EXPECT_GE(apart, 3u);
    EXPECT_GE(nearest, 6u);
}

// ---- the matrix ------------------------------------------------------------------------------------------------------

TEST(StabilityMatrix, IsJsonAndText)
{
    StabilityOptions options;
    options.methods = {parseMethod("ours-mask"), parseMethod("nearest2"), parseMethod("blocks-index")};
    options.cases = {"twice", "two", "radius-0", "budget-50"};
    const std::vector<StabilityTrial> trials = runStability(options);
    const nlohmann::ordered_json json = stabilityJson(trials);
    std::vector<std::string> verdicts;
    for (const auto& object : json) verdicts.push_back(object["verdict"]);
    const std::vector<std::string> expected = {"exact",   "wrong",   "exact",   "exact",
                                               "exact",   "exact",   "refused", "refused",
                                               "refused", "skipped", "skipped", "exact"};
    EXPECT_EQ(verdicts, expected);
    EXPECT_EQ(json[1]["case"], "twice");
    EXPECT_EQ(json[1]["method"], "nearest2");
    EXPECT_GT(json[1]["missing"], 0);
    EXPECT_TRUE(json[1]["holds"].is_null());
    EXPECT_EQ(json[0]["holds"], true);
    EXPECT_GT(json[0]["seconds"], 0);
    EXPECT_GT(json[0]["peak_rss_bytes"], 0);
    const std::string text = stabilityText(trials);
    for (const char* part : {"\nbudget-50", "\nradius-0", "refused", "is not a positive finite number",
                             "7 of 7 trials of exact methods"}) {
        EXPECT_NE(text.find(part), std::string::npos) << part << " is not in\n" << text;
    }
    EXPECT_EQ(text.find("FAULT"), std::string::npos) << text;
}

// A peer without such a search has a dash; the loop of everybody's first program takes a negative radius as a
// positive one.
TEST(StabilityMatrix, WhatAMethodHasNotIsLeftOut)
{
    StabilityOptions options;
    options.methods = {parseMethod("ours-index"), parseMethod("openvdb"), parseMethod("brute-force"),
                       parseMethod("blocks-mask")};
    options.cases = {"radii-bad-scatter", "nearest-8"};
    const std::vector<StabilityTrial> trials = runStability(options);
    std::vector<Verdict> verdicts;
    for (const StabilityTrial& trial : trials) verdicts.push_back(trial.verdict);
    const std::vector<Verdict> expected = {Verdict::kExact,   Verdict::kSkipped, Verdict::kWrong,
                                           Verdict::kSkipped, Verdict::kExact,   Verdict::kSkipped,
                                           Verdict::kExact,   Verdict::kSkipped};
    ASSERT_EQ(verdicts, expected);
    EXPECT_EQ(trials[1].message, "has no radii of candidates");
    EXPECT_EQ(trials[5].message, "has no search of the nearest");
    EXPECT_EQ(trials[2].missing, 0u);
    EXPECT_GT(trials[2].extra, 0u);
    const std::string text = stabilityText(trials);
    EXPECT_EQ(text.find("FAULT"), std::string::npos) << text;
    EXPECT_NE(text.find("2 of 2 trials of exact methods"), std::string::npos) << text;
}

TEST(StabilityMatrix, MeasuresAreThoseOfTheEngineOnTheCpu)
{
    StabilityOptions options;
    options.methods = {parseMethod("ours-visit"), parseMethod("ours-mask"), parseMethod("brute-force"),
                       parseMethod("blocks-mask")};
    options.cases = {"measures-two", "measures-nearest-8", "measures-mass-negative"};
    const std::vector<StabilityTrial> trials = runStability(options);
    std::vector<Verdict> verdicts;
    for (const StabilityTrial& trial : trials) verdicts.push_back(trial.verdict);
    const std::vector<Verdict> expected = {Verdict::kExact,   Verdict::kExact,   Verdict::kSkipped,
                                           Verdict::kSkipped, Verdict::kExact,   Verdict::kSkipped,
                                           Verdict::kSkipped, Verdict::kSkipped, Verdict::kRefused,
                                           Verdict::kRefused, Verdict::kSkipped, Verdict::kSkipped};
    ASSERT_EQ(verdicts, expected);
    EXPECT_EQ(trials[2].message, "has no measures");
    EXPECT_EQ(trials[3].message, "measures are made on the CPU, whoever finds the lists");
    EXPECT_EQ(trials[5].message, "holds no masks of the nearest");
    EXPECT_TRUE(trials[8].isClear) << trials[8].message;
    const std::string text = stabilityText(trials);
    EXPECT_NE(text.find("5 of 5 trials of exact methods"), std::string::npos) << text;
}

StabilityTrial trialWith(Verdict verdict, RightOutcome right, bool isClear = true)
{
    StabilityTrial trial;
    trial.caseName = "a case";
    trial.method = "ours-index";
    trial.isExact = true;
    trial.verdict = verdict;
    trial.right = right;
    trial.isClear = isClear;
    return trial;
}

TEST(StabilityMatrix, OursHoldsWhatItPromises)
{
    const auto holds = [](Verdict verdict, RightOutcome right) {
        return oursHolds(trialWith(verdict, right));
    };
    EXPECT_TRUE(holds(Verdict::kExact, RightOutcome::kAnswer));
    EXPECT_TRUE(holds(Verdict::kExact, RightOutcome::kAnswerOrRefusal));
    EXPECT_FALSE(holds(Verdict::kExact, RightOutcome::kRefusal));
    EXPECT_FALSE(holds(Verdict::kRefused, RightOutcome::kAnswer));
    EXPECT_TRUE(holds(Verdict::kRefused, RightOutcome::kAnswerOrRefusal));
    EXPECT_TRUE(holds(Verdict::kRefused, RightOutcome::kRefusal));
    for (const Verdict verdict : {Verdict::kWrong, Verdict::kCrash, Verdict::kHang, Verdict::kMemory}) {
        EXPECT_FALSE(holds(verdict, RightOutcome::kAnswerOrRefusal)) << verdict;
        EXPECT_FALSE(holds(verdict, RightOutcome::kRefusal)) << verdict;
    }
    EXPECT_TRUE(holds(Verdict::kSkipped, RightOutcome::kAnswer));
    EXPECT_FALSE(oursHolds(trialWith(Verdict::kRefused, RightOutcome::kRefusal, false)));
}

TEST(StabilityMatrix, AFaultOfOursIsShouted)
{
    StabilityTrial wrong = trialWith(Verdict::kWrong, RightOutcome::kAnswer);
    wrong.missing = 2;
    wrong.extra = 123'456;
    const std::string text = stabilityText({wrong});
    EXPECT_NE(text.find("!2+123k"), std::string::npos) << text;
    EXPECT_NE(text.find("FAULT OF OURS: a case: ours-index is wrong; an exact answer is due"),
              std::string::npos)
        << text;
    EXPECT_NE(text.find("0 of 1 trials"), std::string::npos) << text;
    StabilityTrial off = trialWith(Verdict::kWrong, RightOutcome::kAnswer);
    off.wrongValues = 12'345;
    off.message = "density is nan, particle 7";
    const std::string offText = stabilityText({off});
    EXPECT_NE(offText.find("!12k off"), std::string::npos) << offText;
    EXPECT_NE(offText.find("a case: ours-index: density is nan, particle 7"), std::string::npos) << offText;
    EXPECT_EQ(stabilityJson({off})[0]["wrong_values"], 12'345);
}

} // namespace

} // namespace vdb_nns::cli
