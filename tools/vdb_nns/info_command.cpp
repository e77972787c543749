// vdb_nns info: what is in a point file.
#include "cli_options.h"
#include "command.h"
#include "exit_codes.h"
#include "report.h"
#include "standard_streams.h"
#include "threads.h"
#include "vdb_nns/point_file.h"

#include <memory>

namespace vdb_nns::cli {
namespace {

struct InfoFlags {
    CommonFlags common;
    InputFlags input;
};

int describeFile(const InfoFlags& flags, Session& session)
{
    ProgressPrinter progress(progressMode(flags.common));
    progress.begin("read", 0, 1);
    const PointFile file = PointFile::read(flags.input.path, pointFileOptions(flags.input, 0, &progress));
    session.path = flags.input.path;
    const PointFileInfo& info = file.info();
    throwIfStopped();
    progress.finish();
    deliverJson(flags.common.json, infoJson(info), outputOptions(flags.common));
    if (!flags.common.quiet && !jsonToStdout(flags.common)) writeSummary(infoText(info));
    return kDone;
}

int runInfoCommand(const InfoFlags& flags, Session& session)
{
    ThreadLimit threads(threadCount(flags.common));
    checkOutputs({}, {flags.input.path}, flags.common);
    return threads.run([&] { return describeFile(flags, session); });
}

} // namespace

Command addInfoCommand(CLI::App& app)
{
    CLI::App* command = app.add_subcommand("info", "show what is in a point file");
    const auto flags = std::make_shared<InfoFlags>();
    command->add_option("IN", flags->input.path, kInputHelp)->required()->check(notEmpty());
    addInputFlags(*command, flags->input, false);
    addCommonFlags(*command, flags->common);
    return {command, [flags](Session& session) { return runInfoCommand(*flags, session); }};
}

} // namespace vdb_nns::cli
