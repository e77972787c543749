// Signals that end the program: a first one becomes a flag that running steps poll through Progress::cancelled(). None leaves a
// temporary file.
#pragma once

namespace vdb_nns::cli {

/// The first SIGHUP, SIGINT or SIGTERM is remembered. A second one, and SIGQUIT, kill at once, when the temporary files are
/// removed. SIGPIPE and SIGXFSZ are ignored, so that a closed pipe and a file-size limit come back as write errors.
void installSignalHandlers();

/// The signal that asked to stop, or 0.
int stopSignal();

} // namespace vdb_nns::cli
