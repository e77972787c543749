#include "cli_app.h"

#include "command.h"
#include "command_words.h"
#include "exit_codes.h"
#include "failure.h"
#include "help_markdown.h"
#include "signals.h"
#include "standard_streams.h"
#include "thread_failure.h"
#include "threads.h"
#include "vdb_nns/error.h"
#include "vdb_nns/version.h"

#include <tbb/global_control.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <cstddef>
#include <new>
#include <utility>

namespace vdb_nns::cli {
namespace {

int explainStop(int signal)
{
    stopDeadline();
    std::fputs(stopMessage(signal), stderr);
    return stopCode(signal);
}

// Called inside a catch block.
int explainException(const Session& session)
{
    claimEnd();
    try {
        const Failure failure = failureOf(session);
        say("error: " + failure.message);
        return failure.code;
    } catch (const Cancelled&) {
        return explainStop(stopSignal());
    }
}

// CLI11 has exit codes of its own; help and version are not errors.
int explainParseError(const CLI::App& app, const CLI::ParseError& error)
{
    const bool isAnswer = error.get_exit_code() == static_cast<int>(CLI::ExitCodes::Success);
    // Why words seem to be missing, or what there is no help for.
    const std::string unknown = isAnswer && !app.get_subcommands().empty() ? "" : unknownWords(app);
    if (!unknown.empty()) throw InvalidInput(unknown);
    if (isAnswer) {
        const bool isVersion = error.get_name() == "CallForVersion";
        writeStdout(isVersion ? std::string(error.what()) + "\n" : app.help());
        return kDone;
    }
    throw InvalidInput(std::string(error.what()) + "; see vdb_nns --help");
}

// Session::memoryFlags.
std::string memoryFlags(const CLI::App& command)
{
    std::vector<std::string> flags;
    for (const char* flag : {"--host-memory", "--device-memory", "--encoding", "--radius"}) {
        if (command.get_option_no_throw(flag)) flags.push_back(flag);
    }
    if (flags.empty() || flags.front() != "--host-memory") return {}; // of a command that does not search
    std::string text = flags.front();
    for (std::size_t k = 1; k < flags.size(); ++k) text += (k + 1 < flags.size() ? ", " : " and ") + flags[k];
    return text;
}

// Keeps TBB's scheduler. Where memory ends while oneTBB (2022.1) starts it, it waits for itself for ever: so it starts before anything
// else, with room for it.
class TbbScheduler {
public:
    TbbScheduler()
    {
        if (!isFree(std::size_t(8) << 20)) throw std::bad_alloc();
        // How many threads there can ever be is set now.
        const tbb::global_control most(tbb::global_control::max_allowed_parallelism, kMostThreads);
        mArena.initialize();
    }

private:
    tbb::task_arena mArena{1};
};

int runCommand(const CLI::App& app, const std::vector<Command>& commands, bool asMarkdown, Session& session)
{
    if (asMarkdown) {
        writeStdout(helpMarkdown(app));
        return kDone;
    }
    for (const Command& command : commands) {
        if (!command.app->parsed()) continue;
        session.memoryFlags = memoryFlags(*command.app);
        const TbbScheduler scheduler;
        return command.run(session);
    }
    throw InvalidInput("no command given; see vdb_nns --help");
}

} // namespace

int runCommandLine(int argc, char** argv)
{
    Session session;
    try {
        CLI::App app("Finds, for every particle of a sparse point set, all others within a radius, exactly.",
                     "vdb_nns");
        bool asMarkdown = false;
        app.set_version_flag("--version", std::string(buildInfo()),
                             "print version, build and instruction sets");
        app.add_flag("--help-markdown", asMarkdown, "print all flags as Markdown tables");
        app.require_subcommand(0, 1);
        app.allow_extras(); // see unknownWords()
        const std::vector<Command> commands = {
            addSearchCommand(app), addPlanCommand(app),    addSceneCommand(app), addVerifyCommand(app),
            addBenchCommand(app),  addConvertCommand(app), addMergeCommand(app), addInfoCommand(app)};
        for (const Command& command : commands) command.app->allow_extras();
        app.footer("vdb_nns help COMMAND says more."); // last: commands made after it would have it too
        std::vector<std::string> words = withHelp({argv + std::min(argc, 1), argv + argc});
        std::reverse(words.begin(), words.end()); // as the parser wants them
        try {
            app.parse(std::move(words));
        } catch (const CLI::ParseError& error) {
            return explainParseError(app, error);
        }
        const std::string unknown = unknownWords(app);
        if (!unknown.empty()) throw InvalidInput(unknown);
        return runCommand(app, commands, asMarkdown, session);
    } catch (...) {
        return explainException(session);
    }
}

} // namespace vdb_nns::cli
