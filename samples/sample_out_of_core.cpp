// A search on a device that is too small for it: estimate, workload tree, schedule, run. The device is a simulated one with
// 8 MiB; the lists are those of a search on the CPU.
#include <vdb_nns/planning/executor.h>
#include <vdb_nns/scene.h>
#include <vdb_nns/search.h>

#include <cstdint>
#include <cstdio>
#include <vector>

int main()
{
    vdb_nns::SceneOptions sceneOptions;
    sceneOptions.name = "dam_break";
    sceneOptions.count = 200000;
    const vdb_nns::Scene scene = vdb_nns::makeScene(sceneOptions);
    const auto view = vdb_nns::ParticleView::fromArray(scene.positions.data(), scene.positions.size() / 3);

    vdb_nns::SearchEngine engine;
    const vdb_nns::SparseGrid grid = engine.buildGrid(view, scene.suggestedRadius);

    vdb_nns::DeviceLimits device;
    device.name = "a small device";
    device.memoryBytes = std::uint64_t(8) << 20;
    const std::vector<vdb_nns::DeviceLimits> devices = {device};

    // What each leaf asks for; then the nodes of the tree, as far down as the device's memory needs; then who runs what.
    const vdb_nns::WorkEstimate estimate = vdb_nns::estimateWork(grid);
    vdb_nns::WorkloadTreeOptions treeOptions;
    treeOptions.model.encoding = vdb_nns::Encoding::kIndex;
    treeOptions.nodeBytes = vdb_nns::nodeBytesFor(grid, estimate, treeOptions.model, devices);
    const vdb_nns::WorkloadTree tree = vdb_nns::buildWorkloadTree(grid, estimate, treeOptions);
    const vdb_nns::Schedule schedule = vdb_nns::makeSchedule(grid, tree, devices);

    vdb_nns::ScheduleRun run;
    const vdb_nns::NeighborLists lists = engine.search(grid, schedule, devices, {}, run);
    std::printf("%llu pairs, %.0f were expected; %zu blocks, %llu of them on the device, which used %llu "
                "bytes of %llu\n",
                static_cast<unsigned long long>(lists.pairCount()), estimate.total.expectedPairs,
                schedule.blocks.size(), static_cast<unsigned long long>(run.devices[0].blocks),
                static_cast<unsigned long long>(run.devices[0].peakBytes),
                static_cast<unsigned long long>(device.memoryBytes));
    return lists.checksum() == vdb_nns::findNeighbors(view, scene.suggestedRadius).checksum() ? 0 : 1;
}
