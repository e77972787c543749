// SIGINT and SIGTERM become a flag that running steps poll through Progress::cancelled().
#pragma once

namespace vdb_nns::cli {

/// The first SIGINT or SIGTERM is remembered, a second one kills at once. SIGPIPE and SIGXFSZ are ignored, so
/// that a closed pipe and a file-size limit come back as write errors.
void installSignalHandlers();

/// The signal that asked to stop, or 0.
int stopSignal();

} // namespace vdb_nns::cli
