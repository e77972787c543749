#include "bench/studies/budget_study.h"

#include "numbers.h"
#include "vdb_nns/error.h"
#include "vdb_nns/planning/plan.h"
#include "vdb_nns/search.h"

#include <cmath>
#include <iterator>
#include <limits>

namespace vdb_nns::cli {
namespace {

constexpr double kShares[] = {1, 0.5, 0.25, 0.1, 0.05, 0.02, 0.01};

// What all particles need as one block.
std::uint64_t bytesNeeded(const BenchPoints& points, const BudgetStudyOptions& options, Encoding encoding,
                          const ProgressSpan& span)
{
    DeviceOptions request = options.setup.devices.request;
    request.devices.resize(1);
    request.devices[0].memoryBytes = std::numeric_limits<std::uint64_t>::max() / 4;
    SearchOptions search = options.setup.options;
    search.wideCells = false; // as methods on devices have it
    const SparseGrid grid = SearchEngine().buildGrid(points.view, options.radius, search);
    return makePlan(grid, request, encoding, PlanDetail::kFull, &span.printer).everything.total();
}

void run(const BenchPoints& points, const BudgetStudyOptions& options, const ProgressSpan& span,
         BudgetResult& result)
{
    MethodSetup setup = options.setup;
    setup.devices.request.devices.resize(1);
    setup.devices.budgetBytes = result.budgetBytes;
    MethodSpec spec = parseMethod(result.encoding == Encoding::kIndex ? "blocks-index" : "blocks-mask");
    std::vector<double> seconds;
    try {
        const std::unique_ptr<Method> method = makeMethod(spec, setup);
        for (std::uint64_t r = 0; r < options.repeat; ++r) {
            const DeviceMeasures measures = *method->run(points.view, options.radius, span).device;
            method->discard();
            seconds.push_back(measures.makespanSeconds);
            result.blocks = measures.blocks;
            result.overflows = measures.overflows;
            result.retries = measures.retries;
            result.splits = measures.splits;
            result.cpuParticles = measures.cpuParticles;
            if (measures.isVirtual) break; // the model's clock says the same each time
        }
        result.seconds = median(seconds);
    } catch (const CapacityError& error) {
        result.message = error.what();
    } catch (const InvalidInput& error) { // nothing at all fits
        result.message = error.what();
    }
}

} // namespace

std::vector<BudgetResult> studyBudgets(const BenchPoints& points, const BudgetStudyOptions& options,
                                       const ProgressSpan& span)
{
    const DeviceLimits& device = options.setup.devices.request.devices.front();
    std::vector<BudgetResult> results;
    const std::size_t steps = 2 * (1 + std::size(kShares));
    std::size_t step = 0;
    for (const Encoding encoding : {Encoding::kIndex, Encoding::kMask}) {
        const ProgressSpan plan = span.part(step++, steps);
        plan.printer.begin("budgets", plan.begin, plan.end);
        const std::uint64_t needed = bytesNeeded(points, options, encoding, plan);
        for (const double share : kShares) {
            BudgetResult result;
            result.scene = points.scene;
            result.device = device.name;
            result.isModel = device.kind == DeviceKind::kSim;
            result.encoding = encoding;
            result.share = share;
            result.points = points.view.size();
            result.budgetBytes = static_cast<std::uint64_t>(std::ceil(share * static_cast<double>(needed)));
            run(points, options, span.part(step++, steps), result);
            results.push_back(result);
        }
    }
    return results;
}

} // namespace vdb_nns::cli
