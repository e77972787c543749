// What control groups leave, on folders made as the kernel shows them.
#include "util/cgroup_memory.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <limits>

#include <unistd.h>

namespace vdb_nns::testing {

namespace {

namespace fs = std::filesystem;

constexpr std::uint64_t kUnlimited = std::numeric_limits<std::uint64_t>::max();
constexpr const char* kMount1 =
    "35 31 0:32 / /sys/fs/cgroup/memory rw,relatime shared:9 - cgroup cgroup rw,memory\n";
constexpr const char* kMount2 =
    "31 23 0:28 / /sys/fs/cgroup rw,nosuid shared:4 master:2 - cgroup2 cgroup2 rw\n";
constexpr const char* kOtherMounts = "23 1 8:1 / / rw - ext4 /dev/sda1 rw\n"
                                     "32 31 0:29 / /sys/fs/cgroup/cpu rw - cgroup cgroup rw,cpu\n";

class CgroupMemory : public ::testing::Test {
protected:
    void SetUp() override
    {
        const auto* test = ::testing::UnitTest::GetInstance()->current_test_info();
        mRoot = fs::path(::testing::TempDir()) /
                ("vdb_nns_cgroup_" + std::to_string(::getpid()) + "_" + test->name());
        fs::create_directories(mRoot);
    }
    void TearDown() override { fs::remove_all(mRoot); }

    void write(const std::string& path, const std::string& content)
    {
        const std::string file = mRoot.string() + path;
        fs::create_directories(fs::path(file).parent_path());
        std::ofstream(file) << content;
    }

    void process(const std::string& mounts, const std::string& groups)
    {
        write("/proc/self/mountinfo", kOtherMounts + mounts);
        write("/proc/self/cgroup", groups);
    }

    void level1(const std::string& group, std::uint64_t limit, std::uint64_t used,
                const std::string& statistics = {})
    {
        const std::string folder = "/sys/fs/cgroup/memory" + group;
        write(folder + "/memory.limit_in_bytes", std::to_string(limit) + "\n");
        write(folder + "/memory.usage_in_bytes", std::to_string(used) + "\n");
        write(folder + "/memory.stat", statistics);
    }

    void level2(const std::string& group, const std::string& max, std::uint64_t used,
                const std::string& statistics = {}, const std::string& high = "max")
    {
        const std::string folder = "/sys/fs/cgroup" + group;
        write(folder + "/memory.max", max + "\n");
        write(folder + "/memory.high", high + "\n");
        write(folder + "/memory.current", std::to_string(used) + "\n");
        write(folder + "/memory.stat", statistics);
    }

    std::uint64_t freeBytes() const { return cgroupFreeBytes(mRoot.string()); }

    fs::path mRoot;
};

TEST_F(CgroupMemory, MissingFilesAreNoLimit)
{
    EXPECT_EQ(freeBytes(), kUnlimited);
    process("", "");
    EXPECT_EQ(freeBytes(), kUnlimited);
    process(kMount2, "0::/a\n");
    EXPECT_EQ(freeBytes(), kUnlimited);
    write("/sys/fs/cgroup/a/memory.max", "500\n"); // and its use is not told
    EXPECT_EQ(freeBytes(), 500U);
    process(kMount2, "this is\nno:cgroup file\n");
    EXPECT_EQ(freeBytes(), kUnlimited);
}

TEST_F(CgroupMemory, Version2TakesTheLeastOfAllLevels)
{
    process(kMount2, "0::/system.slice/job.service\n");
    level2("/system.slice/job.service", "max", 100);
    level2("/system.slice", "max", 400);
    EXPECT_EQ(freeBytes(), kUnlimited);
    level2("/system.slice", "1000", 400);
    EXPECT_EQ(freeBytes(), 600U);
    level2("/system.slice/job.service", "300", 100);
    EXPECT_EQ(freeBytes(), 200U);
    level2("/system.slice/job.service", "300", 100, {}, "250");
    EXPECT_EQ(freeBytes(), 150U);
    level2("/system.slice/job.service", "max", 350, {}, "250");
    EXPECT_EQ(freeBytes(), 0U);
    level2("/other", "1", 1);
    level2("/system.slice/job.service", "max", 100);
    EXPECT_EQ(freeBytes(), 600U);
}

TEST_F(CgroupMemory, WhatCanBeReclaimedIsFree)
{
    process(kMount2, "0::/job\n");
    level2("/job", "1000", 900,
           "anon 300\nfile 500\ninactive_file 400\nactive_file 100\nslab_reclaimable 50\n");
    EXPECT_EQ(freeBytes(), 550U);
    level2("/job", "1000", 900, "inactive_file 4000\n");
    EXPECT_EQ(freeBytes(), 1000U);

    process(kMount1, "4:memory:/job\n");
    level1("/job", 1000, 900, "inactive_file 10\ntotal_inactive_file 400\n");
    EXPECT_EQ(freeBytes(), 500U);
}

TEST_F(CgroupMemory, Version1TakesTheLeastOfAllLevels)
{
    constexpr std::uint64_t kNone = 9223372036854771712U; // how version 1 says that there is none
    process(kMount1, "9:name=systemd:/\n5:cpu,memory,pids:/slurm/uid_0/job_7\n1:cpu:/\n");
    level1("", kNone, 5000);
    EXPECT_GT(freeBytes(), kNone / 2);
    level1("/slurm/uid_0/job_7", kNone, 200);
    level1("/slurm", 3000, 2000);
    EXPECT_EQ(freeBytes(), 1000U);
    level1("/slurm/uid_0/job_7", 900, 200);
    EXPECT_EQ(freeBytes(), 700U);
    // A group above that is not shown has a smaller limit.
    level1("/slurm/uid_0/job_7", 900, 200, "hierarchical_memory_limit 500\n");
    EXPECT_EQ(freeBytes(), 300U);
}

TEST_F(CgroupMemory, BothVersionsAtOnce)
{
    process(kMount1 + std::string("41 31 0:38 / /sys/fs/cgroup/unified rw - cgroup2 cgroup2 rw\n"),
            "4:memory:/job\n0::/unit\n");
    fs::create_directories(mRoot / "sys/fs/cgroup/unified/unit"); // without the memory controller
    level1("/job", 1000, 100);
    EXPECT_EQ(freeBytes(), 900U);
    level2("/unified/unit", "500", 100);
    EXPECT_EQ(freeBytes(), 400U);
}

TEST_F(CgroupMemory, ContainersSeeAPart)
{
    // Without a namespace: the group's own folder is mounted, under its name of the host.
    process("35 31 0:32 /docker/abc /sys/fs/cgroup/memory ro - cgroup cgroup rw,memory\n",
            "4:memory:/docker/abc\n");
    level1("", 1000, 100);
    EXPECT_EQ(freeBytes(), 900U);
    // A group inside of it.
    process("35 31 0:32 /docker/abc /sys/fs/cgroup/memory ro - cgroup cgroup rw,memory\n",
            "4:memory:/docker/abc/job\n");
    level1("/job", 500, 100);
    EXPECT_EQ(freeBytes(), 400U);
    // A neighbor whose name begins alike is not inside.
    process("35 31 0:32 /docker/ab /sys/fs/cgroup/memory ro - cgroup cgroup rw,memory\n",
            "4:memory:/docker/abc/job\n");
    EXPECT_EQ(freeBytes(), 900U);
}

TEST_F(CgroupMemory, NamespacesBeginAtTheirRoot)
{
    level2("", "1000", 100);
    for (const char* group : {"0::/\n", "0::/../..\n", "0::/../other\n"}) {
        process(kMount2, group);
        EXPECT_EQ(freeBytes(), 900U) << group;
    }
    process("31 23 0:28 /../.. /sys/fs/cgroup rw - cgroup2 cgroup2 rw\n", "0::/\n");
    EXPECT_EQ(freeBytes(), 900U);
}

TEST_F(CgroupMemory, MountPointsMayHaveBlanks)
{
    process("31 23 0:28 / /my\\040groups rw - cgroup2 cgroup2 rw\n", "0::/job\n");
    write("/my groups/job/memory.max", "1000");
    write("/my groups/job/memory.current", "100");
    EXPECT_EQ(freeBytes(), 900U);
}

} // namespace

} // namespace vdb_nns::testing
