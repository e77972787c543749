#include "zip_members.h"

#include "throw_if_cancelled.h"
#include "vdb_nns/error.h"

#include <boost/crc.hpp>

#include <algorithm>
#include <array>

#include <zlib.h>

namespace vdb_nns::cli {

namespace {

constexpr std::uint64_t kStored = 0, kDeflated = 8; // ways of compression
constexpr std::uint64_t kMostInflation = 1032;      // bytes that deflate makes of one, at most

struct Entry {
    std::string name;
    std::uint64_t method = kStored;
    std::uint32_t crc = 0;
    std::uint64_t size = 0, storedSize = 0; // storedSize: in the file
    std::uint64_t localHeader = 0;
};

const char* const kDamaged = "cannot be read as a ZIP of arrays";

struct Directory {
    std::uint64_t offset = 0, size = 0, entries = 0;
};

class ZipReader {
public:
    // `fault`: what a file is that cannot be read, for messages.
    ZipReader(const FilePieces& file, const char* fault, const Progress* progress)
        : mFile(file), mFault(fault), mProgress(progress)
    {
    }

    std::vector<Entry> entries() const
    {
        std::vector<Entry> entries;
        const Directory directory = findDirectory();
        std::uint64_t at = directory.offset;
        for (std::uint64_t k = 0; k < directory.entries; ++k) {
            throwIfCancelled(mProgress);
            entries.push_back(readEntry(at));
        }
        return entries;
    }

    std::map<std::string, ByteRange> members() const
    {
        std::map<std::string, ByteRange> members;
        for (const Entry& entry : entries()) {
            if (entry.method != kStored) {
                fail("member '" + entry.name +
                     "' is compressed; only stored ones are read, as scipy.sparse.save_npz("
                     "..., compressed=False) writes them");
            }
            const ByteRange range = locate(entry);
            if (crcOf(range) != entry.crc) failCrc(entry);
            if (!members.emplace(entry.name, range).second) fail("holds '" + entry.name + "' twice");
        }
        return members;
    }

    std::string content(const Entry& entry) const
    {
        const ByteRange range = locate(entry);
        if (entry.size / kMostInflation > entry.storedSize)
            fail("member '" + entry.name + "' claims more bytes than can be in it");
        std::string stored = text(range.begin, range.size), content;
        if (entry.method == kStored) {
            content.swap(stored);
        } else if (entry.method == kDeflated) {
            content = inflated(entry, stored);
        } else {
            fail("member '" + entry.name + "' is compressed in a way that is not read");
        }
        boost::crc_32_type crc;
        crc.process_bytes(content.data(), content.size());
        if (crc.checksum() != entry.crc) failCrc(entry);
        return content;
    }

private:
    static constexpr std::uint64_t kEndBytes = 22, kLocatorBytes = 20;
    static constexpr std::uint64_t kBlockBytes = 1 << 20; // read at once
    static constexpr std::uint64_t kEntryBytes = 46, kLocalBytes = 30;

    [[noreturn]] void fail(const std::string& what) const
    {
        throw InputError(mFile.path() + ": " + mFault + ": the ZIP " + what);
    }

    [[noreturn]] void failCrc(const Entry& entry) const
    {
        fail("member '" + entry.name + "' is damaged: its CRC-32 is wrong");
    }

    // Little-endian number of `bytes` bytes at `at`.
    std::uint64_t number(std::uint64_t at, unsigned bytes) const
    {
        std::array<unsigned char, 8> raw;
        read(at, raw.data(), bytes);
        std::uint64_t value = 0;
        for (unsigned k = 0; k < bytes; ++k) value |= std::uint64_t(raw[k]) << (8 * k);
        return value;
    }

    std::string text(std::uint64_t at, std::uint64_t bytes) const
    {
        std::string text(bytes, '\0');
        read(at, text.data(), bytes);
        return text;
    }

    void read(std::uint64_t at, void* out, std::uint64_t bytes) const
    {
        if (at > mFile.size() || mFile.size() - at < bytes) fail("is cut off");
        mFile.read(at, out, bytes);
    }

    std::uint32_t crcOf(const ByteRange& range) const
    {
        boost::crc_32_type crc;
        std::vector<char> block(std::min<std::uint64_t>(range.size, kBlockBytes));
        for (std::uint64_t done = 0; done < range.size; done += block.size()) {
            throwIfCancelled(mProgress);
            block.resize(std::min<std::uint64_t>(kBlockBytes, range.size - done));
            mFile.read(range.begin + done, block.data(), block.size());
            crc.process_bytes(block.data(), block.size());
        }
        return crc.checksum();
    }

    // The end record stands last, before a comment of up to 65535 bytes whose length it gives.
    Directory findDirectory() const
    {
        for (std::uint64_t comment = 0; comment <= 65535 && comment + kEndBytes <= mFile.size(); ++comment) {
            const std::uint64_t end = mFile.size() - comment - kEndBytes;
            if (number(end, 4) != 0x06054b50 || number(end + 20, 2) != comment) continue;
            Directory directory{number(end + 16, 4), number(end + 12, 4), number(end + 10, 2)};
            if (end >= kLocatorBytes && number(end - kLocatorBytes, 4) == 0x07064b50) {
                const std::uint64_t end64 = number(end - kLocatorBytes + 8, 8);
                if (number(end64, 4) != 0x06064b50) fail("has no ZIP64 end record where it should be");
                directory = {number(end64 + 48, 8), number(end64 + 40, 8), number(end64 + 32, 8)};
            }
            // A directory entry has 46 bytes at least: a huge count cannot keep us busy.
            if (directory.entries > directory.size / kEntryBytes)
                fail("claims more members than its directory holds");
            return directory;
        }
        fail("has no end record");
    }

    // Reads the directory entry at `at` and moves `at` to the next.
    Entry readEntry(std::uint64_t& at) const
    {
        if (number(at, 4) != 0x02014b50) fail("has a damaged directory");
        const std::uint64_t nameBytes = number(at + 28, 2), extraBytes = number(at + 30, 2);
        Entry entry;
        entry.name = text(at + kEntryBytes, nameBytes);
        if (number(at + 8, 2) & 1) fail("member '" + entry.name + "' is encrypted");
        entry.method = number(at + 10, 2);
        entry.crc = static_cast<std::uint32_t>(number(at + 16, 4));
        entry.storedSize = number(at + 20, 4);
        entry.size = number(at + 24, 4);
        entry.localHeader = number(at + 42, 4);
        widen(at + kEntryBytes + nameBytes, extraBytes, {&entry.size, &entry.storedSize, &entry.localHeader});
        if (entry.method == kStored && entry.storedSize != entry.size)
            fail("member '" + entry.name + "' has two sizes");
        at += kEntryBytes + nameBytes + extraBytes + number(at + 32, 2);
        return entry;
    }

    // Takes the values that are all ones in 32 bits from the ZIP64 extra field, where they stand in this
    // order.
    void widen(std::uint64_t extra, std::uint64_t bytes, const std::vector<std::uint64_t*>& values) const
    {
        const std::uint64_t end = extra + bytes;
        while (extra + 4 <= end && number(extra, 2) != 1) extra += 4 + number(extra + 2, 2);
        std::uint64_t at = extra + 4;
        for (std::uint64_t* value : values) {
            if (*value != 0xffffffff) continue;
            if (at + 8 > end) fail("has a damaged ZIP64 field");
            *value = number(at, 8);
            at += 8;
        }
    }

    ByteRange locate(const Entry& entry) const
    {
        const std::uint64_t at = entry.localHeader;
        if (number(at, 4) != 0x04034b50) fail("member '" + entry.name + "' is not where the directory says");
        const std::uint64_t nameBytes = number(at + 26, 2), extraBytes = number(at + 28, 2);
        if (text(at + kLocalBytes, nameBytes) != entry.name)
            fail("member '" + entry.name + "' has two names");
        const std::uint64_t begin = at + kLocalBytes + nameBytes + extraBytes;
        if (begin > mFile.size() || mFile.size() - begin < entry.storedSize) {
            fail("member '" + entry.name + "' reaches past the end of the file");
        }
        return {begin, entry.storedSize};
    }

    std::string inflated(const Entry& entry, std::string& stored) const
    {
        std::string out(entry.size, '\0');
        z_stream stream{};
        if (inflateInit2(&stream, -MAX_WBITS) != Z_OK) throw std::bad_alloc();
        std::size_t in = 0, made = 0;
        int state = Z_OK;
        while (state == Z_OK) { // zlib counts in 32 bits
            const std::size_t nextIn = std::min(stored.size() - in, std::size_t(kBlockBytes));
            const std::size_t nextOut = std::min(out.size() - made, std::size_t(kBlockBytes));
            stream.next_in = reinterpret_cast<Bytef*>(stored.data() + in);
            stream.avail_in = static_cast<uInt>(nextIn);
            stream.next_out = reinterpret_cast<Bytef*>(out.data() + made);
            stream.avail_out = static_cast<uInt>(nextOut);
            state = inflate(&stream, Z_NO_FLUSH);
            in += nextIn - stream.avail_in;
            made += nextOut - stream.avail_out;
        }
        inflateEnd(&stream);
        if (state != Z_STREAM_END || made != out.size() || in != stored.size())
            fail("member '" + entry.name + "' is damaged: it cannot be decompressed");
        return out;
    }

    const FilePieces& mFile;
    const char* mFault;
    const Progress* mProgress;
};

} // namespace

std::map<std::string, ByteRange> zipMembers(const FilePieces& file, const Progress* progress)
{
    return ZipReader(file, "not a file of neighbor lists", progress).members();
}

std::vector<std::string> zipNames(const FilePieces& file)
{
    std::vector<std::string> names;
    for (const Entry& entry : ZipReader(file, kDamaged, nullptr).entries()) names.push_back(entry.name);
    return names;
}

std::string zipContent(const FilePieces& file, const std::string& name, const Progress* progress)
{
    const ZipReader reader(file, kDamaged, progress);
    for (const Entry& entry : reader.entries()) {
        if (entry.name == name) return reader.content(entry);
    }
    throw InputError(file.path() + ": " + kDamaged + ": the ZIP has no member '" + name + "'");
}

} // namespace vdb_nns::cli
