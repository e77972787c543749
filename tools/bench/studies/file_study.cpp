#include "bench/studies/file_study.h"

#include "bench/methods/peers.h"
#include "bench/run_order.h"
#include "bench/run_program.h"
#include "machine.h"
#include "numbers.h"
#include "report.h"
#include "vdb_nns/error.h"
#include "vdb_nns/point_file.h"
#include "vdb_nns/search.h"

#include <cerrno>
#include <cstdlib>
#include <filesystem>
#include <functional>
#include <system_error>

#include <fcntl.h>
#include <unistd.h>

namespace vdb_nns::cli {
namespace {

namespace fs = std::filesystem;

class Study {
public:
    Study(const FileStudyOptions& options, Progress* progress)
        : mOptions(options), mProgress(progress), mNothing(::open("/dev/null", O_RDWR | O_CLOEXEC))
    {
        mOptions.search.progress = nullptr;
        mIsVdb = fs::path(mOptions.path).extension() == ".vdb";
        mFile = readFile();
        mPositions = worldPositions<float>(mFile.view());
        mArray = ParticleView::fromArray(mPositions.data(), mFile.view().size());
    }
    ~Study() { ::close(mNothing); }

    FileResult run(const ProgressSpan& span)
    {
        FileResult result;
        result.points = mFile.view().size();
        runWhole(); // for its output
        searchWarm(result);
        result.inputBytes = fs::file_size(mOptions.path);
        result.outputBytes = fs::file_size(mOutput);
        const std::vector<std::function<void()>> turns = {[&] { readTurn(); }, [&] { searchTurn(); },
                                                          [&] { copyTurn(); },
                                                          [&] { mWhole.push_back(runWhole()); }};
        for (std::uint64_t run = 0; run < mOptions.repeat; ++run) {
            for (const std::size_t turn : orderOfRun(turns.size(), run)) {
                if (mProgress->cancelled()) throw Cancelled("cancelled during step files");
                turns[turn]();
            }
            span.printer.update("files", static_cast<double>(run + 1) / static_cast<double>(mOptions.repeat));
        }
        result.readSeconds = median(mRead);
        if (mIsVdb) result.openVdbReadSeconds = median(mOpenVdbRead);
        result.gridSeconds = median(mGrid);
        result.arrayGridSeconds = median(mArrayGrid);
        result.searchSeconds = median(mSearch);
        result.copySeconds = median(mCopy);
        result.wholeSeconds = median(mWhole);
        return result;
    }

private:
    PointFile readFile() const { return PointFile::read(mOptions.path, mOptions.input); }

    void searchWarm(FileResult& result)
    {
        mEngine.buildGrid(mArray, mOptions.radius, mOptions.search);
        result.pairs =
            mEngine.search(mEngine.buildGrid(mFile.view(), mOptions.radius, mOptions.search), mOptions.search)
                .pairCount();
    }

    void readTurn()
    {
        const Stopwatch watch;
        const PointFile file = readFile();
        mRead.push_back(watch.seconds());
        if (mIsVdb) mOpenVdbRead.push_back(timeOpenVdbRead(mOptions.path));
    }

    void searchTurn()
    {
        const Stopwatch arrayWatch;
        mEngine.buildGrid(mArray, mOptions.radius, mOptions.search);
        mArrayGrid.push_back(arrayWatch.seconds());
        const Stopwatch gridWatch;
        const SparseGrid grid = mEngine.buildGrid(mFile.view(), mOptions.radius, mOptions.search);
        mGrid.push_back(gridWatch.seconds());
        const Stopwatch searchWatch;
        mEngine.search(grid, mOptions.search);
        mSearch.push_back(searchWatch.seconds());
    }

    void copyTurn()
    {
        const std::string input = mFolder.file("input"), output = mFolder.file("output");
        const Stopwatch watch;
        runChild({"cp", "--reflink=never", mOptions.path, input});
        runChild({"cp", "--reflink=never", mOutput, output});
        mCopy.push_back(watch.seconds());
        fs::remove(input);
        fs::remove(output);
    }

    // Seconds that the whole process takes.
    double runWhole()
    {
        fs::remove(mOutput); // freeing what was there is no part of it
        std::vector<std::string> command = {"/proc/self/exe",
                                            "search",
                                            mOptions.path,
                                            "-o",
                                            mOutput,
                                            "-q",
                                            "-r",
                                            shortest(mOptions.radius),
                                            "-T",
                                            std::to_string(mOptions.threads)};
        command.insert(command.end(), mOptions.inputFlags.begin(), mOptions.inputFlags.end());
        const Stopwatch watch;
        runChild(command);
        return watch.seconds();
    }

    void runChild(const std::vector<std::string>& command) const
    {
        const int status = runProgram(command, {mNothing, mNothing, STDERR_FILENO});
        if (status != 0) {
            throw OutputError("study of files: '" + command[0] + "' ended with status " +
                              std::to_string(status) + " on " + mOptions.path);
        }
    }

    FileStudyOptions mOptions;
    Progress* mProgress;
    int mNothing;
    bool mIsVdb = false;
    TemporaryFolder mFolder;
    std::string mOutput = mFolder.file("lists.npz");
    PointFile mFile;
    std::vector<float> mPositions;
    ParticleView mArray;
    SearchEngine mEngine;
    std::vector<double> mRead, mOpenVdbRead, mGrid, mArrayGrid, mSearch, mCopy, mWhole;
};

} // namespace

TemporaryFolder::TemporaryFolder()
{
    std::error_code error;
    const fs::path parent = fs::temp_directory_path(error);
    mPath = (parent / "vdb_nns_bench_XXXXXX").string();
    if (error || !::mkdtemp(mPath.data()))
        throw OutputError("no folder for temporary files: " + std::generic_category().message(errno) +
                          "; set TMPDIR to one with room");
}

TemporaryFolder::~TemporaryFolder()
{
    std::error_code ignored;
    fs::remove_all(mPath, ignored);
}

FileResult studyFiles(const std::string& scene, const FileStudyOptions& options, const ProgressSpan& span)
{
    FileResult result = Study(options, &span.printer).run(span);
    result.scene = scene;
    return result;
}

} // namespace vdb_nns::cli
