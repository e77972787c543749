// The .xyz reader: text, cut at line ends into chunks that are read in parallel.
#include "io/array_readers.h"

#include "vdb_nns/error.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <charconv>
#include <cstdlib>
#include <cstring>
#include <optional>
#include <utility>

namespace vdb_nns {

namespace {

// Large enough that a chunk's start-up is nothing, small enough to share the work of a file of some MB.
constexpr std::size_t kChunkBytes = std::size_t(1) << 20;

struct Fault {
    std::size_t byte; // offset in the file
    std::string what;
};

struct Chunk {
    const char* begin;
    const char* end;
    std::size_t points;
    std::vector<double> values;
    std::optional<Fault> fault; // the first one of the chunk
};

bool isBlank(char c)
{
    return c == ' ' || c == '\t' || c == '\r' || c == '\v' || c == '\f';
}

const char* skipBlanks(const char* next, const char* end)
{
    while (next != end && isBlank(*next)) ++next;
    return next;
}

const char* findLineEnd(const char* next, const char* end)
{
    const void* const newline = std::memchr(next, '\n', static_cast<std::size_t>(end - next));
    return newline ? static_cast<const char*>(newline) : end;
}

std::string shown(const char* begin, const char* end)
{
    std::string text;
    for (const char* c = begin; c != end && text.size() < 40; ++c) text += *c >= 32 && *c < 127 ? *c : '?';
    return "'" + text + "'";
}

// Reads one number; advances `next` behind it. Returns what is wrong, or null.
const char* readNumber(const char*& next, const char* end, double& value)
{
    next = skipBlanks(next, end);
    if (next == end || *next == '#') return "has fewer than three numbers";
    const char* first = next;
    if (*first == '+' && first + 1 != end && first[1] != '-') ++first; // from_chars takes no plus sign
    const std::from_chars_result result = std::from_chars(first, end, value);
    if (result.ec == std::errc::invalid_argument) return "has something that is not a number";
    if (result.ptr != end && !isBlank(*result.ptr) && *result.ptr != '#') {
        return "has something that is not a number";
    }
    if (result.ec == std::errc::result_out_of_range) {
        // Too small is rounded to the nearest double, which strtod does; too large has none.
        value = std::strtod(std::string(first, result.ptr).c_str(), nullptr);
        if (value > 1 || value < -1) return "has a number beyond the range of double (1.8e308)";
    }
    next = result.ptr;
    return nullptr;
}

// Calls use(line, first, lineEnd) for each line that is neither blank nor a comment, with the first character that says
// something, until it returns false.
template <typename Use>
void forEachDataLine(const char* begin, const char* end, const Use& use)
{
    for (const char* line = begin; line != end;) {
        const char* const lineEnd = findLineEnd(line, end);
        const char* const first = skipBlanks(line, lineEnd);
        if (first != lineEnd && *first != '#' && !use(line, first, lineEnd)) return;
        line = lineEnd == end ? lineEnd : lineEnd + 1;
    }
}

void countPoints(Chunk& chunk)
{
    forEachDataLine(chunk.begin, chunk.end, [&](const char*, const char*, const char*) {
        ++chunk.points;
        return true;
    });
}

void readChunk(Chunk& chunk, const char* fileBegin)
{
    chunk.values.reserve(3 * chunk.points);
    forEachDataLine(chunk.begin, chunk.end, [&](const char* line, const char* next, const char* lineEnd) {
        for (int k = 0; k < 3; ++k) {
            double value = 0;
            if (const char* const what = readNumber(next, lineEnd, value)) {
                chunk.fault = Fault{static_cast<std::size_t>(line - fileBegin), what};
                return false;
            }
            chunk.values.push_back(value);
        }
        return true;
    });
}

std::vector<Chunk> cutIntoChunks(const char* begin, const char* end)
{
    std::vector<Chunk> chunks;
    while (begin != end) {
        const char* cut = end;
        if (static_cast<std::size_t>(end - begin) > kChunkBytes) {
            cut = findLineEnd(begin + kChunkBytes, end);
            if (cut != end) ++cut;
        }
        chunks.push_back({begin, cut, 0, {}, std::nullopt});
        begin = cut;
    }
    return chunks;
}

// Whether the first line that says something is one integer and nothing else.
void refuseCountLine(const std::string& path, const char* begin, const char* end)
{
    forEachDataLine(begin, end, [&](const char* line, const char* first, const char* lineEnd) {
        const char* last = first + (*first == '+' || *first == '-' ? 1 : 0);
        while (last != lineEnd && *last >= '0' && *last <= '9') ++last;
        const char* const rest = skipBlanks(last, lineEnd);
        if (last != first && (rest == lineEnd || *rest == '#')) {
            throw InputError(
                path + ": line " + std::to_string(1 + std::count(begin, line, '\n')) + " is one integer, " +
                shown(first, last) +
                ", as in chemistry's .xyz, which is not supported; remove the count, the comment " +
                "line and the names so that each line has three numbers");
        }
        return false;
    });
}

} // namespace

ReadArray parseText(const ArrayFile& file)
{
    const std::string& path = file.path;
    const FileBytes bytes = file.bytes;
    const CancelCheck& cancel = file.cancel;
    const char* const begin = reinterpret_cast<const char*>(bytes.data());
    const char* const end = begin + bytes.size();
    refuseCountLine(path, begin, end);

    std::vector<Chunk> chunks = cutIntoChunks(begin, end);
    const auto forEachChunk = [&](const auto& use) {
        tbb::parallel_for(std::size_t(0), chunks.size(), [&](std::size_t i) {
            cancel.check();
            use(i);
        });
    };
    forEachChunk([&](std::size_t i) { countPoints(chunks[i]); });
    std::uint64_t points = 0;
    for (const Chunk& chunk : chunks) points += chunk.points;
    // Read by chunks, then put together.
    checkPointsFit(path, 2 * points * 3 * sizeof(double), file.allowedBytes);
    forEachChunk([&](std::size_t i) { readChunk(chunks[i], begin); });

    PositionArray result;
    std::vector<std::size_t> starts(1, 0);
    for (const Chunk& chunk : chunks) {
        if (chunk.fault) {
            const char* const line = begin + chunk.fault->byte;
            throw InputError(path + ": line " + std::to_string(1 + std::count(begin, line, '\n')) +
                             " (byte " + std::to_string(chunk.fault->byte) + ") " + chunk.fault->what + ": " +
                             shown(line, findLineEnd(line, end)) +
                             "; a line is x y z, with spaces or tabs between");
        }
        starts.push_back(starts.back() + chunk.values.size());
    }
    if (starts.back() / 3 > kMaxFilePoints) {
        throw InputError(path + ": " + std::to_string(starts.back() / 3) + " points are more than the " +
                         std::to_string(kMaxFilePoints) + " that fit; split the file");
    }
    result.doubles.reserve(starts.back());
    for (const std::size_t start : starts) {
        cancel.check();
        result.doubles.resize(start);
    }
    forEachChunk([&](std::size_t i) {
        std::copy(chunks[i].values.begin(), chunks[i].values.end(), result.doubles.begin() + starts[i]);
        std::vector<double>().swap(chunks[i].values);
    });
    return {std::move(result), {}, {}};
}

} // namespace vdb_nns
