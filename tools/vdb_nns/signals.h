// Signals that end the program leave no temporary file. Those that ask it to stop become a flag first, which
// running steps poll through Progress::cancelled().
#pragma once

namespace vdb_nns::cli {

/// The first SIGHUP, SIGINT or SIGTERM is remembered; steps that have not stopped 0.15 s later are ended, with the
/// message and the exit code that they would have had. A second one kills at once, as SIGQUIT, SIGABRT,
/// SIGUSR1, SIGUSR2 and the signals of timers and time limits do, after the temporary files are removed.
/// SIGPIPE and SIGXFSZ are ignored, so that a closed pipe and a file-size limit come back as write errors.
void installSignalHandlers();

/// The signal that asked to stop, or 0.
int stopSignal();

/// The steps have stopped: nothing is to be ended any more.
void stopDeadline();

/// What the program says, with the end of the line, and returns when that signal stops it.
const char* stopMessage(int signal);
int stopCode(int signal);

} // namespace vdb_nns::cli
