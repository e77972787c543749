// The .npz reader: a ZIP of .npy files (PKWARE's APPNOTE.TXT 6.3: 4.3.7 local header, 4.3.12 directory, 4.3.14 to 4.3.16 its
// end, 4.5.3 ZIP64).
#include "io/array_readers.h"
#include "util/shown_text.h"
#include "vdb_nns/error.h"

#include <algorithm>
#include <cstring>
#include <optional>

#include <zlib.h>

namespace vdb_nns {

namespace {

constexpr std::uint32_t kEnd = 0x06054b50, kEnd64 = 0x06064b50, kEnd64Locator = 0x07064b50,
                        kEntry = 0x02014b50, kLocal = 0x04034b50;
constexpr std::uint16_t kStored = 0, kDeflated = 8, kEncrypted = 1, kZip64Field = 1;
constexpr std::size_t kEndBytes = 22, kMostCommentBytes = 65535, kEntryBytes = 46, kLocalBytes = 30;
// What is looked at of an array whose values are not wanted: more than its header can have.
constexpr std::uint64_t kHeadBytes = std::uint64_t(66) << 10;
// Deflate makes at most 1032 bytes of one.
constexpr std::uint64_t kMostExpansion = 1032;

struct Member {
    std::string name; // without .npy
    std::uint16_t method = 0, flags = 0;
    std::uint32_t crc = 0;
    std::uint64_t storedBytes = 0, bytes = 0, localOffset = 0;
};

class ZipReader {
public:
    explicit ZipReader(const ArrayFile& file) : mFile(file) {}

    std::vector<Member> readDirectory() const
    {
        const std::uint64_t end = findEnd();
        std::uint64_t count = at<std::uint16_t>(end + 10), offset = at<std::uint32_t>(end + 16);
        if (count == 0xFFFF || offset == 0xFFFFFFFFu) {
            if (end < 20 || at<std::uint32_t>(end - 20) != kEnd64Locator) fail("a ZIP64 locator", end);
            const auto end64 = at<std::uint64_t>(end - 12);
            if (at<std::uint32_t>(end64) != kEnd64) fail("the ZIP64 end of the directory", end64);
            count = at<std::uint64_t>(end64 + 32);
            offset = at<std::uint64_t>(end64 + 48);
        }
        if (count > mFile.bytes.size() / kEntryBytes) fail("a number of members that fits the file", end);
        std::vector<Member> members;
        for (; count > 0; --count) members.push_back(readEntry(offset));
        return members;
    }

    // The first bytes of a member, enough for the header of an array; its checksum is not looked at.
    FileBytes readHead(const Member& member, std::vector<unsigned char>& storage) const
    {
        const std::uint64_t begin = beginOf(member);
        const FileBytes stored(take(begin, member.storedBytes), static_cast<std::size_t>(member.storedBytes));
        if (member.method == kStored) return stored;
        if (member.method != kDeflated) fail("a member that is stored or deflated", member.localOffset);
        storage.resize(static_cast<std::size_t>(std::min(member.bytes, kHeadBytes)));
        inflateInto(stored, storage, begin, member.bytes > kHeadBytes);
        return {storage.data(), storage.size()};
    }

    // The bytes of a member, in the file or decompressed into `storage`.
    FileBytes read(const Member& member, std::vector<unsigned char>& storage) const
    {
        const std::uint64_t begin = beginOf(member);
        const unsigned char* const stored = take(begin, member.storedBytes);
        FileBytes bytes(stored, static_cast<std::size_t>(member.storedBytes));
        if (member.method == kDeflated) {
            if (member.bytes / kMostExpansion > member.storedBytes)
                fail("a size that deflate can have", begin);
            checkPointsFit(mFile.path, member.bytes, mFile.allowedBytes);
            storage.resize(static_cast<std::size_t>(member.bytes));
            inflateInto(bytes, storage, begin, /*isHead=*/false);
            bytes = {storage.data(), storage.size()};
        } else if (member.method != kStored || member.bytes != member.storedBytes) {
            fail("a member that is stored or deflated", member.localOffset);
        }
        if (::crc32_z(0, bytes.data(), bytes.size()) != member.crc)
            fail("the checksum of array '" + shownText(member.name) + "', which is damaged,", begin);
        return bytes;
    }

private:
    // Of its values in the file.
    std::uint64_t beginOf(const Member& member) const
    {
        if (member.flags & kEncrypted) fail("a member that is not encrypted", member.localOffset);
        if (at<std::uint32_t>(member.localOffset) != kLocal) fail("a local header", member.localOffset);
        return member.localOffset + kLocalBytes + at<std::uint16_t>(member.localOffset + 26) +
               at<std::uint16_t>(member.localOffset + 28);
    }

    [[noreturn]] void fail(const std::string& expected, std::uint64_t at) const
    {
        throw InputError(mFile.path + ": is no .npz file that can be read: expected " + expected +
                         " at byte " + std::to_string(at) + "; copy it again or write it with numpy.savez");
    }

    const unsigned char* take(std::uint64_t offset, std::uint64_t bytes) const
    {
        if (offset > mFile.bytes.size() || bytes > mFile.bytes.size() - offset)
            fail(std::to_string(bytes) + " bytes more", offset);
        return mFile.bytes.data() + offset;
    }

    template <typename Number>
    Number at(std::uint64_t offset) const
    {
        Number value;
        std::memcpy(&value, take(offset, sizeof value), sizeof value);
        return value;
    }

    std::uint64_t findEnd() const
    {
        const std::size_t size = mFile.bytes.size();
        for (std::size_t back = kEndBytes; back <= std::min(size, kEndBytes + kMostCommentBytes); ++back) {
            if (at<std::uint32_t>(size - back) == kEnd &&
                at<std::uint16_t>(size - back + 20) == back - kEndBytes)
                return size - back;
        }
        fail("the end of a ZIP directory", size);
    }

    Member readEntry(std::uint64_t& offset) const
    {
        if (at<std::uint32_t>(offset) != kEntry) fail("an entry of the directory", offset);
        Member member;
        member.flags = at<std::uint16_t>(offset + 8);
        member.method = at<std::uint16_t>(offset + 10);
        member.crc = at<std::uint32_t>(offset + 16);
        member.storedBytes = at<std::uint32_t>(offset + 20);
        member.bytes = at<std::uint32_t>(offset + 24);
        const auto nameBytes = at<std::uint16_t>(offset + 28), extraBytes = at<std::uint16_t>(offset + 30),
                   commentBytes = at<std::uint16_t>(offset + 32);
        member.localOffset = at<std::uint32_t>(offset + 42);
        const unsigned char* const name = take(offset + kEntryBytes, nameBytes);
        member.name.assign(name, name + nameBytes);
        readZip64(offset + kEntryBytes + nameBytes, extraBytes, member);
        const std::size_t length = member.name.size();
        if (length > 4 && member.name.compare(length - 4, 4, ".npy") == 0) member.name.resize(length - 4);
        offset += kEntryBytes + nameBytes + extraBytes + commentBytes;
        return member;
    }

    // Sizes that do not fit their fields stand in an extra one, in this order.
    void readZip64(std::uint64_t offset, std::uint64_t bytes, Member& member) const
    {
        for (const std::uint64_t end = offset + bytes; offset + 4 <= end;) {
            const auto id = at<std::uint16_t>(offset), size = at<std::uint16_t>(offset + 2);
            std::uint64_t next = offset + 4;
            if (id == kZip64Field) {
                for (std::uint64_t* value : {&member.bytes, &member.storedBytes, &member.localOffset}) {
                    if (*value != 0xFFFFFFFFu || next + 8 > offset + 4 + size) continue;
                    *value = at<std::uint64_t>(next);
                    next += 8;
                }
            }
            offset += 4 + std::uint64_t(size);
        }
    }

    // @param isHead the member has more bytes than `out`
    void inflateInto(FileBytes from, std::vector<unsigned char>& out, std::uint64_t begin, bool isHead) const
    {
        constexpr std::size_t kPiece = std::size_t(64) << 20; // zlib counts in 32 bits
        z_stream stream{};
        if (::inflateInit2(&stream, -MAX_WBITS) != Z_OK) throw std::bad_alloc();
        std::size_t taken = 0, made = 0;
        int status = Z_OK;
        while (status == Z_OK && !(isHead && made == out.size())) {
            mFile.cancel.check();
            const std::size_t in = std::min(kPiece, from.size() - taken),
                              room = std::min(kPiece, out.size() - made);
            stream.next_in = const_cast<unsigned char*>(from.data() + taken);
            stream.avail_in = static_cast<uInt>(in);
            stream.next_out = out.data() + made;
            stream.avail_out = static_cast<uInt>(room);
            status = ::inflate(&stream, Z_NO_FLUSH);
            taken += in - stream.avail_in;
            made += room - stream.avail_out;
        }
        ::inflateEnd(&stream);
        if ((status != Z_STREAM_END && !isHead) || made != out.size()) fail("deflated values", begin);
    }

    const ArrayFile& mFile;
};

const Member& choose(const ArrayFile& file, const std::vector<Member>& members)
{
    std::string names;
    for (const Member& member : members)
        names += (names.empty() ? "'" : ", '") + shownText(member.name) + "'";
    if (members.empty()) throw InputError(file.path + ": the .npz file has no arrays");
    if (file.choice.array.empty()) {
        if (members.size() == 1) return members[0];
        for (const Member& member : members) {
            if (member.name == "positions") return member; // as we write it
        }
        throw InvalidInput(file.path + ": has several arrays: " + names + "; name one of them (--array)");
    }
    for (const Member& member : members) {
        if (member.name == file.choice.array) return member;
    }
    throw InvalidInput(file.path + ": has no array '" + file.choice.array + "'; its arrays are " + names);
}

} // namespace

std::vector<StoredValue> listNpzArrays(const ArrayFile& file, std::uint64_t points)
{
    const ZipReader zip(file);
    const std::vector<Member> members = zip.readDirectory();
    const Member& positions = choose(file, members);
    std::vector<StoredValue> list;
    for (const Member& member : members) {
        if (&member == &positions) continue;
        const auto hasName = [&](const Member& other) { return other.name == member.name; };
        if (std::count_if(members.begin(), members.end(), hasName) > 1) {
            list.push_back({member.name, "unknown", false, {}, "is there twice"});
            continue;
        }
        std::vector<unsigned char> storage;
        const std::string path = file.path + ": array '" + shownText(member.name) + "'";
        try {
            list.push_back(describeNpyValues(path, member.name, zip.readHead(member, storage), points));
        } catch (const InputError&) { // it may be anything, and is in nobody's way
            list.push_back({member.name, "unknown", false, {}, "is no .npy array that can be read"});
        }
    }
    return list;
}

PointValues readNpzArrays(const ArrayFile& file, const std::vector<StoredValue>& which, std::uint64_t points)
{
    const ZipReader zip(file);
    const std::vector<Member> members = zip.readDirectory();
    std::uint64_t rowBytes = 0;
    for (const StoredValue& value : which) rowBytes += value.isGroup ? 1 : attributeBytes(*value.readAs);
    checkPointsFit(file.path, rowBytes * points, file.allowedBytes);
    PointValues values;
    for (const StoredValue& value : which) {
        const auto member = std::find_if(members.begin(), members.end(),
                                         [&](const Member& each) { return each.name == value.name; });
        const std::string path = file.path + ": array '" + shownText(value.name) + "'";
        if (member == members.end()) throw InputError(path + " is not there any more; start again");
        std::vector<unsigned char> storage;
        const FileBytes bytes = zip.read(*member, storage);
        const StoredValue found = describeNpyValues(path, value.name, bytes, points);
        if (found.readAs != value.readAs || found.isGroup != value.isGroup)
            throw InputError(path + " has changed since it was looked at; start again");
        readNpyValues({path, bytes, file.choice, file.allowedBytes, file.cancel}, value, points, values);
    }
    return values;
}

ReadArray parseNpz(const ArrayFile& file)
{
    const ZipReader zip(file);
    const std::vector<Member> members = zip.readDirectory();
    const Member& member = choose(file, members);
    const std::string name = "array '" + shownText(member.name) + "'";
    std::vector<unsigned char> storage;
    const FileBytes bytes = zip.read(member, storage);
    ReadArray result;
    NpyLayout layout;
    const std::string path = file.path + ": " + name;
    if (parseNpy({path, bytes, file.choice, file.allowedBytes, file.cancel}, layout, result)) {
        const unsigned char* const first = bytes.data() + layout.dataOffset;
        const std::size_t count = 3 * layout.count;
        checkPointsFit(file.path, count * (layout.isDouble ? sizeof(double) : sizeof(float)),
                       file.allowedBytes);
        if (layout.isDouble) {
            result.positions.doubles.resize(count);
            if (count > 0) std::memcpy(result.positions.doubles.data(), first, count * sizeof(double));
        } else {
            result.positions.floats.resize(count);
            if (count > 0) std::memcpy(result.positions.floats.data(), first, count * sizeof(float));
        }
    }
    result.taken = result.taken.empty() ? name : name + ", " + result.taken;
    return result;
}

} // namespace vdb_nns
