// The engine of `vdb_nns verify`: right lists of every distribution pass, each planted fault is found and named, and
// files that lie are refused.
#include "../support/distributions.h"
#include "../support/lists_writer.h"
#include "../support/oracle.h"
#include "set_source.h"
#include "vdb_nns/error.h"
#include "vdb_nns/particle_view.h"
#include "verify/exact_pair.h"
#include "verify/independent_search.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <cmath>
#include <filesystem>

namespace vdb_nns::testing {

namespace {

using cli::Fault;
using cli::VerifyReport;

class Verify : public ::testing::Test {
protected:
    void SetUp() override
    {
        const auto* test = ::testing::UnitTest::GetInstance()->current_test_info();
        mPath = ::testing::TempDir() + "vdb_nns_verify_" + test->name() + ".npz";
    }
    void TearDown() override { std::filesystem::remove(mPath); }

    VerifyReport verify(const PointSet& set, const RawLists& lists, const cli::VerifyOptions& options = {})
    {
        writeBytes(mPath, zipBytes(listMembers(lists)));
        return cli::verifyLists(viewOf(set), set.radius, cli::ListsFile::open(mPath), options);
    }

    // Exactly one fault, of this kind, at this pair.
    void expectOnly(const VerifyReport& report, Fault fault, std::uint64_t query, std::int64_t neighbor)
    {
        EXPECT_EQ(report.faultCount(), 1U);
        const cli::FaultFinding& finding = report.finding(fault);
        EXPECT_EQ(finding.count, 1U) << cli::faultName(fault);
        ASSERT_EQ(finding.examples.size(), 1U) << cli::faultName(fault);
        EXPECT_EQ(finding.examples[0].query, query);
        EXPECT_EQ(finding.examples[0].neighbor, neighbor);
    }

    void expectRefused(const std::string& bytes, const std::string& why)
    {
        writeBytes(mPath, bytes);
        try {
            cli::ListsFile::open(mPath);
            FAIL() << "accepted: " << why;
        } catch (const InputError& error) {
            EXPECT_NE(std::string(error.what()).find(why), std::string::npos) << error.what();
        }
    }

    std::string mPath;
};

// Six points on a line, one apart, radius 1.5: point i has the neighbors i - 1 and i + 1.
PointSet line()
{
    PointSet set{"line", 1.5, {}, kIdentity};
    for (int i = 0; i < 6; ++i) set.points.push_back({{0, 0, 0}, {double(i), 0, 0}});
    return set;
}

Lists lineRows()
{
    return {{1}, {0, 2}, {1, 3}, {2, 4}, {3, 5}, {4}};
}

TEST_F(Verify, RightListsOfEveryDistributionPass)
{
    std::vector<PointSet> sets = gridSets();
    for (const Precision precision : {Precision::kFloat, Precision::kDouble}) {
        for (const PointSet& set : arraySets(precision)) sets.push_back(set);
    }
    for (const PointSet& set : sets) {
        const RawLists lists = rawLists(oracleLists(set));
        cli::VerifyOptions sample;
        sample.sample = 40;
        for (const cli::VerifyOptions& options : {cli::VerifyOptions(), sample}) {
            const VerifyReport report = verify(set, lists, options);
            EXPECT_TRUE(report.passed()) << set.name;
            EXPECT_EQ(report.listedPairs, report.expectedPairs) << set.name;
            const std::uint64_t all = set.points.size();
            EXPECT_EQ(report.queries, options.sample ? std::min<std::uint64_t>(all, 40) : all) << set.name;
        }
    }
}

TEST_F(Verify, ListsThatAreCutOffMeanwhileAreAnError)
{
    const PointSet set = line();
    writeBytes(mPath, zipBytes(listMembers(rawLists(lineRows()))));
    const cli::ListsFile lists = cli::ListsFile::open(mPath);
    std::filesystem::resize_file(mPath, 100);
    try {
        cli::verifyLists(viewOf(set), set.radius, lists, {});
        FAIL() << "a file that is not there any more was verified";
    } catch (const InputError& error) {
        EXPECT_NE(std::string(error.what()).find("became shorter"), std::string::npos) << error.what();
    }
}

TEST_F(Verify, TiesAreDecidedExactly)
{
    for (const PointSet& set : gridSets()) {
        if (set.name != "lattice, scale") continue;
        EXPECT_GT(verify(set, rawLists(oracleLists(set))).exactPairs, 1000U);
        PointSet smaller = set;
        smaller.radius = std::nextafter(set.radius, 0);
        const VerifyReport report = verify(smaller, rawLists(oracleLists(set)));
        EXPECT_EQ(report.faultCount(), 6U * 6 * 64); // every tie is extra now
        ASSERT_EQ(report.finding(Fault::kExtra).examples.size(), 10U);
        EXPECT_NEAR(report.finding(Fault::kExtra).examples[0].ulps, 1, 1e-9);
    }
}

TEST_F(Verify, FindsAMissingPair)
{
    Lists rows = lineRows();
    rows[3] = {4};
    const VerifyReport report = verify(line(), rawLists(rows));
    expectOnly(report, Fault::kMissing, 3, 2);
    EXPECT_EQ(report.finding(Fault::kMissing).examples[0].distance, 1);
    EXPECT_EQ(report.finding(Fault::kMissing).examples[0].ulps, -0x1p51); // 0.5 in ulps of 1.5
}

TEST_F(Verify, FindsAnExtraPair)
{
    Lists rows = lineRows();
    rows[0] = {1, 2};
    expectOnly(verify(line(), rawLists(rows)), Fault::kExtra, 0, 2);
}

TEST_F(Verify, FindsSelf)
{
    Lists rows = lineRows();
    rows[2] = {1, 2, 3};
    expectOnly(verify(line(), rawLists(rows)), Fault::kSelf, 2, 2);
}

TEST_F(Verify, FindsADuplicate)
{
    Lists rows = lineRows();
    rows[4] = {3, 3, 5};
    expectOnly(verify(line(), rawLists(rows)), Fault::kDuplicate, 4, 3);
}

TEST_F(Verify, FindsARowOutOfOrder)
{
    Lists rows = lineRows();
    rows[1] = {2, 0};
    expectOnly(verify(line(), rawLists(rows)), Fault::kUnsorted, 1, 0);
}

TEST_F(Verify, FindsNumbersOutOfRange)
{
    RawLists lists = rawLists({{1}, {0, 2}, {1, 3}, {2, 4}, {3, 5}, {4, 6}});
    const VerifyReport report = verify(line(), lists);
    expectOnly(report, Fault::kOutOfRange, 5, 6);
    EXPECT_TRUE(std::isnan(report.finding(Fault::kOutOfRange).examples[0].distance));
    lists.indices.back() = -1;
    const VerifyReport negative = verify(line(), lists);
    EXPECT_EQ(negative.finding(Fault::kOutOfRange).count, 1U);
    EXPECT_EQ(negative.finding(Fault::kUnsorted).count, 1U);
}

TEST_F(Verify, FindsAWrongDistance)
{
    RawLists lists = rawLists(lineRows());
    lists.distances.assign(lists.indices.size(), 1.0F);
    EXPECT_TRUE(verify(line(), lists).passed());
    lists.distances[3] = std::nextafter(1.0F, 2.0F);
    const VerifyReport report = verify(line(), lists);
    expectOnly(report, Fault::kWrongDistance, 2, 1);
    EXPECT_EQ(report.finding(Fault::kWrongDistance).examples[0].fileValue, std::nextafter(1.0F, 2.0F));
    lists.distances[3] = std::nanf("");
    EXPECT_EQ(verify(line(), lists).finding(Fault::kWrongDistance).count, 1U);
}

TEST_F(Verify, FindsAConnectivityThatIsNotOne)
{
    Members members = listMembers(rawLists(lineRows()));
    members[2].second.back() = 2;
    writeBytes(mPath, zipBytes(members));
    expectOnly(cli::verifyLists(viewOf(line()), 1.5, cli::ListsFile::open(mPath)), Fault::kWrongDistance, 5,
               4);
}

TEST_F(Verify, PointsThatAreNotFiniteHaveEmptyRows)
{
    PointSet set = line();
    set.points[3].offset[1] = INFINITY;
    EXPECT_TRUE(verify(set, rawLists({{1}, {0, 2}, {1}, {}, {5}, {4}})).passed());
    const VerifyReport report = verify(set, rawLists({{1}, {0, 2}, {1, 3}, {2}, {5}, {4}}));
    EXPECT_EQ(report.finding(Fault::kExtra).count, 2U);
    EXPECT_EQ(report.faultCount(), 2U);
}

TEST_F(Verify, ASampleFindsFaultsToo)
{
    Lists rows = lineRows();
    rows[2] = {1};
    cli::VerifyOptions options;
    options.sample = 100; // more than there are: all
    expectOnly(verify(line(), rawLists(rows), options), Fault::kMissing, 2, 3);
    options.sample = 3;
    int found = 0;
    for (options.seed = 1; options.seed <= 20; ++options.seed) {
        found += verify(line(), rawLists(rows), options).passed() ? 0 : 1;
    }
    EXPECT_GT(found, 2); // half of the samples hold the row
    EXPECT_LT(found, 18);
}

TEST_F(Verify, TheReportIsTheSameForAnyThreads)
{
    const PointSet set = arraySets(Precision::kFloat)[5];
    RawLists lists = rawLists(oracleLists(set));
    for (std::size_t k = 0; k < lists.indices.size(); k += 97) lists.indices[k] = 5;
    std::vector<std::vector<std::uint64_t>> reports;
    for (const std::size_t threads : {1, 4}) {
        const tbb::global_control control(tbb::global_control::max_allowed_parallelism, threads);
        const VerifyReport report = verify(set, lists);
        std::vector<std::uint64_t> numbers;
        for (const auto& finding : report.findings) {
            numbers.push_back(finding.count);
            for (const auto& example : finding.examples) numbers.push_back(example.query);
        }
        reports.push_back(numbers);
    }
    EXPECT_GT(reports[0].size(), 20U);
    EXPECT_EQ(reports[0], reports[1]);
}

TEST_F(Verify, RefusesListsOfOtherPoints)
{
    EXPECT_THROW(verify(line(), rawLists({{1}, {0}})), InputError);
    PointSet set = line();
    for (const double radius : {0.0, -1.0, static_cast<double>(NAN), static_cast<double>(INFINITY)}) {
        set.radius = radius;
        EXPECT_THROW(verify(set, rawLists(lineRows())), InvalidInput) << radius;
    }
}

// ---- files that lie -----------------------------------------------------------------------------------------------

TEST_F(Verify, RefusesWhatIsNotAZip)
{
    EXPECT_THROW(cli::ListsFile::open(mPath), InputError); // no such file
    EXPECT_THROW(cli::ListsFile::open(::testing::TempDir()), InputError);
    expectRefused("", "is empty");
    expectRefused(std::string(1000, 'x'), "no end record");
}

TEST_F(Verify, RefusesAFileCutAnywhere)
{
    const std::string whole = zipBytes(listMembers(rawLists(lineRows())));
    for (std::size_t size = 1; size < whole.size(); size += 7) {
        writeBytes(mPath, whole.substr(0, size));
        EXPECT_THROW(cli::ListsFile::open(mPath), InputError) << size;
    }
}

TEST_F(Verify, ADamagedByteIsRefusedOrHarmless)
{
    const std::string whole = zipBytes(listMembers(rawLists(lineRows())));
    std::size_t refused = 0;
    for (std::size_t at = 0; at < whole.size(); ++at) {
        std::string damaged = whole;
        damaged[at] = static_cast<char>(damaged[at] ^ 0x41);
        writeBytes(mPath, damaged);
        try {
            // Accepted bytes are ones that nobody reads: times, versions, attributes. The lists must be the same.
            EXPECT_TRUE(cli::verifyLists(viewOf(line()), 1.5, cli::ListsFile::open(mPath)).passed()) << at;
        } catch (const InputError&) {
            ++refused;
        }
    }
    EXPECT_GT(refused, whole.size() / 2);
}

TEST_F(Verify, RefusesArraysThatLie)
{
    const RawLists good = rawLists(lineRows());
    const auto with = [&](std::size_t member, const std::string& bytes) {
        Members members = listMembers(good);
        members[member].second = bytes;
        return zipBytes(members);
    };
    const std::string offsets = bytesOf<std::int64_t>(good.offsets);
    expectRefused(with(0, npyBytes("<f8", "(7,)", offsets)), "type '<f8'");
    expectRefused(with(0, npyBytes("<i8", "(8,)", offsets)), "another size");
    expectRefused(with(0, npyBytes("<i8", "(999,)", offsets)), "claims more elements");
    expectRefused(with(0, npyBytes("<i8", "(4294967296,4294967297)", offsets)), "claims more elements");
    expectRefused(with(0, npyBytes("<i8", "(6,)", offsets)), "another size");
    expectRefused(with(0, npyBytes("<i8", "(7,1)", offsets)), "2 dimensions");
    expectRefused(with(0, npyBytes("<i8", "(99999999999999999999,)", offsets)), "absurd");
    expectRefused(with(0, offsets), "not a .npy array");
    expectRefused(with(1, npyBytes("<i4", "(0,)", "")), "differ in length");
    expectRefused(with(3, npyBytes("<i8", "(2,)", bytesOf<std::int64_t>(std::vector<int>{7, 6}))),
                  "rows of 'indptr'");
    expectRefused(with(4, npyBytes("|S3", "()", "csc")), "CSR");
    for (const std::size_t missing : {0U, 1U, 2U, 3U, 4U}) {
        Members members = listMembers(good);
        members.erase(members.begin() + static_cast<std::ptrdiff_t>(missing));
        expectRefused(zipBytes(members), "has no array");
    }
    Members doubled = listMembers(good);
    doubled.push_back(doubled[1]);
    expectRefused(zipBytes(doubled), "twice");
}

TEST_F(Verify, RefusesRowOffsetsThatLie)
{
    const auto with = [](std::size_t at, std::int64_t value) {
        RawLists lists = rawLists(lineRows());
        lists.offsets[at] = value;
        return zipBytes(listMembers(lists));
    };
    expectRefused(with(0, 1), "begin with 0");
    expectRefused(with(3, 2), "decreases");
    expectRefused(with(3, -5), "decreases");
    expectRefused(with(2, std::int64_t(1) << 40), "decreases");
    expectRefused(with(6, 11), "ends with 11");
}

// ---- the exact test -----------------------------------------------------------------------------------------------

TEST(ExactPair, AgreesWithTheOracle)
{
    for (const PointSet& set : gridSets(5)) {
        for (std::size_t i = 0; i < set.points.size(); i += 37) {
            for (std::size_t j = 0; j < set.points.size(); j += 11) {
                const ExactPoint &a = set.points[i], &b = set.points[j];
                if (!isFinite(a) || !isFinite(b)) continue;
                const cli::StoredPoint p{{a.voxel[0], a.voxel[1], a.voxel[2]},
                                         {a.offset[0], a.offset[1], a.offset[2]}};
                const cli::StoredPoint q{{b.voxel[0], b.voxel[1], b.voxel[2]},
                                         {b.offset[0], b.offset[1], b.offset[2]}};
                EXPECT_EQ(cli::withinRadius(p, q, set.linear, set.radius),
                          withinExactly(a, b, set.linear, set.radius))
                    << set.name << ": " << i << ", " << j;
            }
        }
    }
}

} // namespace

} // namespace vdb_nns::testing
