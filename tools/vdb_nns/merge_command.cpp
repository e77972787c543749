// vdb_nns merge: the parts of a search in tiles into one file of lists.
#include "cli_options.h"
#include "command.h"
#include "exit_codes.h"
#include "machine.h"
#include "report.h"
#include "standard_streams.h"
#include "threads.h"
#include "vdb_nns/error.h"
#include "vdb_nns/tiles.h"
#include "vdb_nns/version.h"

#include <nlohmann/json.hpp>

#include <cstring>
#include <memory>
#include <string>
#include <vector>

#include <sys/resource.h>

namespace vdb_nns::cli {
namespace {

using Json = nlohmann::ordered_json;

struct MergeFlags {
    CommonFlags common;
    std::vector<std::string> parts;
    std::string output;
};

std::string mergeJson(const MergeFlags& flags, const MergedParts& merged, double seconds)
{
    const Json json = {{"schema", 1},
                       {"version", VDB_NNS_VERSION},
                       {"command", "merge"},
                       {"parts", flags.parts.size()},
                       {"rows", merged.rows},
                       {"columns", merged.columns},
                       {"pairs", merged.pairs},
                       {"output", flags.output},
                       {"memory", {{"peak_rss_bytes", peakMemoryBytes()}}},
                       {"seconds", {{"total", seconds}}}};
    return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

// The parts are read, then the file is written.
class MergeProgress final : public Progress {
public:
    explicit MergeProgress(ProgressPrinter& printer) : mPrinter(printer) {}

    void update(const char* step, double fraction) override
    {
        const bool isRead = std::strcmp(step, "read") == 0;
        mPrinter.update(step, isRead ? kRead * fraction : kRead + (1 - kRead) * fraction);
    }
    bool cancelled() const override { return mPrinter.cancelled(); }

private:
    static constexpr double kRead = 0.3; // its share, roughly

    ProgressPrinter& mPrinter;
};

// All parts are open at once.
void allowManyFiles()
{
    rlimit limit = {};
    if (::getrlimit(RLIMIT_NOFILE, &limit) != 0) return;
    limit.rlim_cur = limit.rlim_max;
    ::setrlimit(RLIMIT_NOFILE, &limit);
}

int mergeFiles(const MergeFlags& flags)
{
    const Stopwatch watch;
    ProgressPrinter progress(progressMode(flags.common));
    progress.begin("merge", 0, 1);
    const OutputOptions output = outputOptions(flags.common);
    MergeProgress steps(progress);
    const MergedParts merged = mergeNpzParts(flags.parts, flags.output, output, &steps);
    throwIfStopped();
    progress.finish();
    const double seconds = watch.seconds();
    deliverJson(flags.common.json, mergeJson(flags, merged, seconds), output);
    if (flags.common.quiet || jsonToStdout(flags.common)) return kDone;
    writeSummary(line("parts", countText(flags.parts.size())) +
                 line("rows", countText(merged.rows) + ", of " + countText(merged.columns) + " columns") +
                 line("pairs", countText(merged.pairs)) + line("time", format("%.3f s", seconds)) +
                 line("written", flags.output));
    return kDone;
}

int runMergeCommand(const MergeFlags& flags)
{
    if (extensionOf(flags.output) != ".npz")
        throw InvalidInput(flags.output + ": has another extension than .npz, the format of lists");
    checkNotInput(flags.output, flags.parts);
    checkOutputs({flags.output}, flags.parts, flags.common);
    allowManyFiles();
    ThreadLimit threads(threadCount(flags.common));
    return threads.run([&] { return mergeFiles(flags); });
}

} // namespace

Command addMergeCommand(CLI::App& app)
{
    CLI::App* command = app.add_subcommand("merge", "make one file of the parts of search --tile");
    const auto flags = std::make_shared<MergeFlags>();
    command->add_option("PART", flags->parts, "parts of all tiles of one search, in any order")
        ->required()
        ->check(notEmpty());
    command->add_option("-o,--output", flags->output, "neighbor lists (.npz)")
        ->required()
        ->type_name("OUT")
        ->check(notEmpty());
    addCommonFlags(*command, flags->common);
    return {command, [flags](Session&) { return runMergeCommand(*flags); }};
}

} // namespace vdb_nns::cli
