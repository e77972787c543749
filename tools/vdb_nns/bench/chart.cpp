#include "bench/chart.h"

#include "text_file.h"
#include "vdb_nns/error.h"

#include <cerrno>
#include <cstdlib>
#include <fcntl.h>
#include <filesystem>
#include <optional>
#include <spawn.h>
#include <sys/wait.h>
#include <system_error>
#include <unistd.h>
#include <vector>

extern char** environ;

namespace vdb_nns::cli {
namespace {

namespace fs = std::filesystem;

// Beside the program as it was built, and in share/vdb_nns of where it was installed.
std::optional<fs::path> findScript()
{
    std::error_code error;
    const fs::path folder = fs::read_symlink("/proc/self/exe", error).parent_path();
    for (const char* place : {"share/vdb_nns/chart.py", "../share/vdb_nns/chart.py"}) {
        if (fs::exists(folder / place, error)) return folder / place;
    }
    return std::nullopt;
}

// Runs a program; its output goes to stderr or nowhere. Returns the exit status, 127 where it cannot be run.
int run(const std::vector<std::string>& command, bool isQuiet)
{
    std::vector<char*> arguments;
    for (const std::string& part : command) arguments.push_back(const_cast<char*>(part.c_str()));
    arguments.push_back(nullptr);
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    if (isQuiet) {
        posix_spawn_file_actions_addopen(&actions, 1, "/dev/null", O_WRONLY, 0);
        posix_spawn_file_actions_addopen(&actions, 2, "/dev/null", O_WRONLY, 0);
    } else {
        posix_spawn_file_actions_adddup2(&actions, 2, 1);
    }
    pid_t child = 0;
    const int error = posix_spawnp(&child, arguments[0], &actions, nullptr, arguments.data(), environ);
    posix_spawn_file_actions_destroy(&actions);
    if (error != 0) return 127;
    int status = 0;
    while (waitpid(child, &status, 0) < 0 && errno == EINTR) {
    }
    return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
}

// The Python of the PATH may be another one than the system's, which has the system's packages.
std::optional<std::string> findPython()
{
    for (const char* python : {"python3", "/usr/bin/python3"}) {
        if (run({python, "-c", "import matplotlib"}, true) == 0) return python;
    }
    return std::nullopt;
}

// Removed at the end.
class TemporaryFolder {
public:
    TemporaryFolder()
    {
        std::string pattern = (fs::temp_directory_path() / "vdb_nns_chart_XXXXXX").string();
        if (!mkdtemp(pattern.data())) {
            throw OutputError(pattern + ": cannot be made: " + std::generic_category().message(errno));
        }
        path = pattern;
    }
    ~TemporaryFolder()
    {
        std::error_code ignored;
        fs::remove_all(path, ignored);
    }
    TemporaryFolder(const TemporaryFolder&) = delete;
    TemporaryFolder& operator=(const TemporaryFolder&) = delete;

    fs::path path;
};

} // namespace

std::string missingForCharts()
{
    if (!findScript())
        return "chart.py is not beside the program: install vdb_nns, or run it from its build folder";
    if (!findPython()) return "charts need Python with matplotlib: install python3-matplotlib";
    return {};
}

void writeChart(const std::string& path, const std::string& json)
{
    const std::string missing = missingForCharts();
    if (!missing.empty()) throw OutputError(path + ": not written: " + missing);
    const TemporaryFolder folder;
    const std::string input = (folder.path / "bench.json").string();
    writeWholeFile(input, json.data(), json.size(), true);
    const int status = run({*findPython(), "-B", findScript()->string(), path, input}, false);
    if (status != 0)
        throw OutputError(path + ": not written: chart.py ended with status " + std::to_string(status));
}

} // namespace vdb_nns::cli
