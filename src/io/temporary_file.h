// The file that an output is written to before it takes its name.
//
// It stands beside the target as TARGET.vdb_nns-HOST-PROCESS-COUNT.tmp, and its writer holds a lock on it
// (flock) that ends with the process, however that ends: a file of such a name that nobody holds was left by
// a process that was killed, and the next one that writes the target removes it. On network file systems a
// lock may be seen on its own host alone, so each host removes its own: HOST is the CRC-32 of its name.
// Signals that can be caught need leave none: removeTemporaryFiles().
// (O_TMPFILE would leave none ever. But not every file system has it, and a file that replaces another needs
// a name all the same, so that it would come on top of this.)
#pragma once

#include <string>

namespace vdb_nns {

struct TemporarySlot;

class TemporaryFile {
public:
    // Creates it, open for reading and writing, after what killed processes left for the target is gone.
    // @param target after symbolic links
    // @throws std::system_error
    TemporaryFile(const std::string& target, unsigned mode);

    // Removes it unless it was renamed.
    ~TemporaryFile();
    TemporaryFile(const TemporaryFile&) = delete;
    TemporaryFile& operator=(const TemporaryFile&) = delete;

    int descriptor() const { return mDescriptor; }
    const std::string& name() const { return mName; }

    // Its name is no longer ours to remove.
    void setRenamed() { mIsRenamed = true; }

private:
    std::string mName;
    int mDescriptor = -1;
    TemporarySlot* mSlot = nullptr; // where a signal handler finds its name
    bool mIsRenamed = false;
};

} // namespace vdb_nns
