#include "io/vdb/cursor.h"

#include "util/shown_text.h"
#include "vdb_nns/error.h"

#include <algorithm>

namespace vdb_nns {

namespace {

// Bytes read at once: the parts read here are small against the points, and mostly skipped. A cursor starts with few, for many
// read no more than the entry of a grid, and reads more at once the longer it goes on.
constexpr std::size_t kFirstWindowBytes = std::size_t(4) << 10, kMostWindowBytes = std::size_t(256) << 10;

std::string nameOf(const std::string& part)
{
    return part.empty() ? std::string() : part + ": ";
}

} // namespace

void failDamaged(const std::string& file, const std::string& part, const std::string& expected,
                 std::uint64_t at)
{
    throw InputError(file + ": damaged: " + nameOf(part) + "expected " + escapedText(expected) + " at byte " +
                     std::to_string(at) + "; copy or write the file again");
}

VdbCursor::VdbCursor(const ByteSource& file, std::uint64_t begin, std::uint64_t end)
    : mFile(&file), mPosition(begin), mEnd(end)
{
}

void VdbCursor::fail(const std::string& expected, std::uint64_t at) const
{
    failDamaged(mFile->name(), mPart, expected, at);
}

void VdbCursor::need(std::uint64_t bytes, const char* what) const
{
    if (bytes <= left()) return;
    const bool isEndOfFile = mEnd == mFile->size();
    throw InputError(mFile->name() + (isEndOfFile ? ": truncated or damaged: " : ": damaged: ") +
                     nameOf(mPart) + "expected " + std::to_string(bytes) + " bytes (" + what + ") at byte " +
                     std::to_string(mPosition) + ", but " + (isEndOfFile ? "the file" : "this part of it") +
                     " ends at byte " + std::to_string(mEnd) + "; copy or write the file again");
}

void VdbCursor::skip(std::uint64_t bytes, const char* what)
{
    need(bytes, what);
    mPosition += bytes;
}

std::string VdbCursor::text(const char* what)
{
    const auto length = number<std::uint32_t>(what);
    const unsigned char* const first = take(length, what);
    return std::string(first, first + length);
}

const unsigned char* VdbCursor::take(std::size_t bytes, const char* what)
{
    need(bytes, what);
    const bool isInside = mPosition >= mWindowBegin && mPosition - mWindowBegin + bytes <= mWindow.size();
    if (!isInside) {
        const std::size_t wanted =
            std::min(std::max(kFirstWindowBytes, 2 * mWindow.size()), kMostWindowBytes);
        mWindow.resize(static_cast<std::size_t>(std::min<std::uint64_t>(left(), std::max(bytes, wanted))));
        mFile->readAt(mPosition, mWindow.data(), mWindow.size());
        mWindowBegin = mPosition;
    }
    const unsigned char* const first = mWindow.data() + (mPosition - mWindowBegin);
    mPosition += bytes;
    return first;
}

} // namespace vdb_nns
