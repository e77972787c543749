// One search of one file, as `vdb_nns search` runs it: reading, finding and writing, a call each. The three may be made on different
// threads, one after the other, so that files can follow one another through them.
#pragma once

#include "command.h"
#include "machine.h"
#include "progress_printer.h"
#include "report.h"
#include "search_flags.h"
#include "vdb_nns/search.h"

#include <cstdint>
#include <string>
#include <vector>

namespace vdb_nns::cli {

class SearchRun {
public:
    /// @param session told of the file at work; it and the flags must live as long as this
    SearchRun(const SearchFlags& flags, SearchPlan plan, int threads, Session& session);
    ~SearchRun();
    SearchRun(const SearchRun&) = delete;
    SearchRun& operator=(const SearchRun&) = delete;

    /// Reads points, and all that is made of their values; checks what is to be written against them.
    void read(ProgressPrinter& progress);

    /// Runs the job; the .npz may be written by it.
    /// @param engine must stay, and run nothing else, until write() has returned.
    void find(SearchEngine& engine, ProgressPrinter& progress);

    /// Writes what is still to be written.
    void write(ProgressPrinter& progress);

    /// What was done; complete after write().
    const SearchReport& report() const { return mReport; }

private:
    void chooseTile(ProgressPrinter& progress);
    std::string optionsText() const;
    void writePart(const std::string& path, ProgressPrinter& progress);
    void runJobs(ProgressPrinter& progress);
    void fillReport();
    void makeChecksum();
    PointValues values();
    void reportValues(const PointValues& values);
    void writeOutputs(ProgressPrinter& progress);

    const SearchFlags& mFlags;
    SearchPlan mPlan;
    Session& mSession;
    const Stopwatch mTotal;
    SearchReport mReport;

    QueryInput mInput;
    MeasureInput mMeasured;
    JobOptions mOptions;
    NewGridOptions mGrid;
    KeptOutputs mKept; // of the input, in new files of its points
    std::vector<std::uint32_t> mTileRows;

    SearchEngine* mEngine = nullptr;
    JobReport mJob;
    NeighborLists mLists;
    std::vector<std::uint32_t> mCounts;
};

} // namespace vdb_nns::cli
