#include "cli_app.h"

#include "command.h"
#include "exit_codes.h"
#include "help_markdown.h"
#include "signals.h"
#include "text_file.h"
#include "thread_failure.h"
#include "vdb_nns/error.h"
#include "vdb_nns/version.h"

#include <csignal>
#include <cstdio>
#include <new>

namespace vdb_nns::cli {
namespace {

void printError(const Session& session, const std::string& message)
{
    const bool named = session.path.empty() || message.find(session.path) != std::string::npos;
    const std::string grid = session.grid.empty() ? "" : " (grid " + session.grid + ")";
    const std::string subject = named ? "" : session.path + grid + ": ";
    std::fprintf(stderr, "vdb_nns: error: %s%s\n", subject.c_str(), message.c_str());
}

// The one place where exceptions become exit codes; called inside a catch block.
int explainException(const Session& session)
{
    try {
        throw;
    } catch (const Cancelled&) {
        const int signal = stopSignal();
        std::fprintf(stderr, "vdb_nns: stopped by %s\n", signal == SIGTERM ? "SIGTERM" : "SIGINT");
        return signal == SIGTERM ? kTerminated : kInterrupted;
    } catch (const CheckFailed& e) {
        return printError(session, e.what()), kCheckFailed;
    } catch (const OutputExists& e) {
        return printError({}, e.what()), kBadUsage;
    } catch (const OutputError& e) {
        return printError({}, e.what()), kNotWritten;
    } catch (const InvalidInput& e) {
        return printError(session, e.what()), kBadUsage;
    } catch (const InputError& e) {
        return printError(session, e.what()), kBadInput;
    } catch (const CapacityError& e) {
        printError(session, std::string(e.what()) +
                                "; the flags are --host-memory, --device-memory, --encoding and --radius");
        return kNoRoom;
    } catch (const std::bad_alloc&) {
        printError(session,
                   "the memory is used up; set --host-memory, or hold less with --encoding mask or none");
        return kNoRoom;
    } catch (const DeviceError& e) {
        return printError(session, e.what()), kNoDevice;
    } catch (const std::exception& e) {
        if (isThreadFailure(e)) return printError({}, threadAdvice(e)), kNoRoom;
        return printError(session, std::string("a fault of vdb_nns itself, please report it: ") + e.what()),
               kUnexpected;
    }
}

// CLI11 has exit codes of its own; help and version are not errors.
int explainParseError(const CLI::App& app, const CLI::ParseError& error)
{
    if (error.get_exit_code() == static_cast<int>(CLI::ExitCodes::Success)) {
        const bool isVersion = error.get_name() == "CallForVersion";
        writeStdout(isVersion ? std::string(error.what()) + "\n" : app.help());
        return kDone;
    }
    std::fprintf(stderr, "vdb_nns: error: %s; see vdb_nns --help\n", error.what());
    return kBadUsage;
}

int runCommand(const CLI::App& app, const std::vector<Command>& commands, bool asMarkdown, Session& session)
{
    if (asMarkdown) {
        writeStdout(helpMarkdown(app));
        return kDone;
    }
    for (const Command& command : commands) {
        if (command.app->parsed()) return command.run(session);
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
        const std::vector<Command> commands = {addSearchCommand(app), addPlanCommand(app),
                                               addSceneCommand(app),  addVerifyCommand(app),
                                               addBenchCommand(app),  addInfoCommand(app)};
        try {
            app.parse(argc, argv);
        } catch (const CLI::ParseError& error) {
            return explainParseError(app, error);
        }
        return runCommand(app, commands, asMarkdown, session);
    } catch (...) {
        return explainException(session);
    }
}

} // namespace vdb_nns::cli
