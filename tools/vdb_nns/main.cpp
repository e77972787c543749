// vdb_nns: neighbors of sparse particles from the command line.
#include "cli_app.h"
#include "signals.h"

int main(int argc, char** argv)
{
    vdb_nns::cli::installSignalHandlers();
    return vdb_nns::cli::runCommandLine(argc, argv);
}
