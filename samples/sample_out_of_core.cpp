// A search on a device that is too small for it, in one call; then the same step by step: estimate, workload tree, schedule, run.
// The device is a simulated one with 8 MiB; chooseDevices("auto") takes the GPUs of this machine, and none where there is none.
// All lists are those of a search on the CPU.
#include <vdb_nns/scene.h>
#include <vdb_nns/search_job.h>

#include <cstdint>
#include <cstdio>

int main()
{
    vdb_nns::SceneOptions sceneOptions;
    sceneOptions.name = "dam_break";
    sceneOptions.count = 200000;
    const vdb_nns::Scene scene = vdb_nns::makeScene(sceneOptions);
    const auto view = vdb_nns::ParticleView::fromArray(scene.positions.data(), scene.positions.size() / 3);

    vdb_nns::JobOptions job;
    job.device = vdb_nns::chooseDevices("sim");
    job.device.devices[0].memoryBytes = std::uint64_t(8) << 20;
    vdb_nns::SearchEngine engine;
    vdb_nns::JobReport report;
    const vdb_nns::NeighborLists lists = engine.findNeighbors(view, scene.suggestedRadius, job, report);
    std::printf("%llu pairs, %.0f were expected; %zu blocks, %llu of them on the device, which used %llu "
                "bytes of %llu\n",
                static_cast<unsigned long long>(lists.pairCount()), report.plan->total.expectedPairs,
                report.plan->schedule.blocks.size(),
                static_cast<unsigned long long>(report.run->devices[0].blocks),
                static_cast<unsigned long long>(report.run->devices[0].peakBytes),
                static_cast<unsigned long long>(report.plan->devices[0].memoryBytes));

    // The steps by themselves: what each leaf asks for; the nodes of the tree, as far down as the device's memory needs; who
    // runs what.
    const vdb_nns::SparseGrid& grid = lists.grid();
    const vdb_nns::WorkEstimate estimate = vdb_nns::estimateWork(grid, job.device.estimate);
    vdb_nns::WorkloadTreeOptions treeOptions;
    treeOptions.model = vdb_nns::memoryModel(job.device, vdb_nns::Encoding::kIndex, estimate);
    treeOptions.nodeBytes =
        vdb_nns::nodeBytesFor(grid, estimate, treeOptions.model, job.device.devices, job.device.schedule);
    const vdb_nns::WorkloadTree tree = vdb_nns::buildWorkloadTree(grid, estimate, treeOptions);
    const vdb_nns::Schedule schedule =
        vdb_nns::makeSchedule(grid, tree, job.device.devices, job.device.schedule);
    vdb_nns::RunOptions runOptions;
    runOptions.schedule = job.device.schedule;
    vdb_nns::ScheduleRun run;
    const vdb_nns::NeighborLists same = engine.search(grid, schedule, job.device.devices, runOptions, run);

    const std::uint64_t onTheCpu = vdb_nns::findNeighbors(view, scene.suggestedRadius).checksum();
    return lists.checksum() == onTheCpu && same.checksum() == onTheCpu ? 0 : 1;
}
