// vdb_nns: neighbors of sparse particles from the command line.
#include "cli_app.h"
#include "exit_codes.h"
#include "signals.h"
#include "standard_streams.h"

int main(int argc, char** argv)
{
    if (!vdb_nns::cli::openStandardStreams()) return vdb_nns::cli::kNotWritten;
    vdb_nns::cli::installSignalHandlers();
    return vdb_nns::cli::runCommandLine(argc, argv);
}
