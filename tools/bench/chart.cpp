#include "bench/chart.h"

#include "bench/run_program.h"
#include "vdb_nns/error.h"

#include <array>
#include <cerrno>
#include <fcntl.h>
#include <filesystem>
#include <optional>
#include <sys/mman.h>
#include <sys/stat.h>
#include <system_error>
#include <unistd.h>
#include <vector>

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

// A file in memory: whatever happens, nothing is left of it.
class MemoryFile {
public:
    MemoryFile() : mDescriptor(memfd_create("vdb_nns_chart", MFD_CLOEXEC)) { require(mDescriptor); }
    ~MemoryFile() { close(mDescriptor); }
    MemoryFile(const MemoryFile&) = delete;
    MemoryFile& operator=(const MemoryFile&) = delete;

    int descriptor() const { return mDescriptor; }

    void write(const std::string& text) const
    {
        for (std::size_t done = 0; done < text.size();) {
            done += require(
                pwrite(mDescriptor, text.data() + done, text.size() - done, static_cast<off_t>(done)));
        }
    }

    std::string read() const
    {
        struct stat status {};
        require(fstat(mDescriptor, &status));
        std::string text(static_cast<std::size_t>(status.st_size), '\0');
        for (std::size_t done = 0; done < text.size();) {
            done +=
                require(pread(mDescriptor, text.data() + done, text.size() - done, static_cast<off_t>(done)));
        }
        return text;
    }

private:
    static std::size_t require(ssize_t result)
    {
        if (result < 0)
            throw OutputError("charts: a file in memory failed: " + std::generic_category().message(errno));
        return static_cast<std::size_t>(result);
    }

    int mDescriptor;
};

// Runs Python isolated (-I): of what lies in the folder that the program was started in nothing is imported.
int runPython(const std::string& python, std::vector<std::string> arguments,
              const std::array<int, 3>& streams)
{
    arguments.insert(arguments.begin(), {python, "-I", "-B"});
    return runProgram(arguments, streams, "/"); // where no matplotlibrc lies
}

// The Python of the PATH may be another one than the system's, which has the system's packages.
std::optional<std::string> findPython()
{
    const MemoryFile nothing, ignored;
    for (const char* python : {"python3", "/usr/bin/python3"}) {
        const std::array<int, 3> streams{nothing.descriptor(), ignored.descriptor(), ignored.descriptor()};
        if (runPython(python, {"-c", "import matplotlib"}, streams) == 0) return python;
    }
    return std::nullopt;
}

} // namespace

std::string missingForCharts()
{
    if (!findScript())
        return "chart.py is not beside the program: install vdb_nns, or run it from its build folder";
    if (!findPython()) return "charts need Python with matplotlib: install python3-matplotlib";
    return {};
}

void writeChart(const std::string& path, const std::string& json, const OutputOptions& options)
{
    const std::string missing = missingForCharts();
    if (!missing.empty()) throw OutputError(path + ": not written: " + missing);
    const MemoryFile report, page;
    report.write(json);
    const int status = runPython(*findPython(), {findScript()->string(), "-", "/dev/stdin"},
                                 {report.descriptor(), page.descriptor(), STDERR_FILENO});
    if (status != 0)
        throw OutputError(path + ": not written: chart.py ended with status " + std::to_string(status));
    const std::string html = page.read();
    writeFile(path, html.data(), html.size(), options);
}

} // namespace vdb_nns::cli
