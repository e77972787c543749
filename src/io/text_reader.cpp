// The reader of text: rows of numbers, cut at line ends into chunks that are read in parallel. What the head says is found by
// text_shape.h. All rows have as many fields as the first one; only those of the three columns must be numbers.
#include "io/text_rows.h"
#include "io/text_shape.h"
#include "util/shown_text.h"
#include "vdb_nns/error.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <optional>
#include <utility>

namespace vdb_nns {

namespace {

// Large enough that a chunk's start-up is nothing, small enough to share the work of a file of some MB.
constexpr std::size_t kChunkBytes = std::size_t(1) << 20;

struct Fault {
    const char* line;
    std::string what;
};

struct Chunk {
    const char* begin;
    const char* end;
    std::size_t rows = 0, firstRow = 0;
    std::optional<Fault> fault; // the first one of the chunk
};

// Calls use(line, text) for each line that is neither blank nor a comment, until it returns false.
template <typename Use>
void forEachRow(const char* begin, const char* end, const Use& use)
{
    for (const char* line = begin; line != end;) {
        const char* const lineEnd = findLineEnd(line, end);
        const char* first = line;
        while (first != lineEnd && isBlank(*first)) ++first;
        if (first != lineEnd && *first != '#' &&
            !use(line, std::string_view(first, static_cast<std::size_t>(lineEnd - first))))
            return;
        line = afterLineEnd(lineEnd, end);
    }
}

std::string columnFault(std::uint32_t column, std::string_view field, NumberText read)
{
    const std::string is = "has '" + shownText(field) + "' in column " + std::to_string(column);
    if (read == NumberText::kEmpty) return "has nothing in column " + std::to_string(column);
    if (read == NumberText::kTooLarge) return is + ", which is beyond the range of double (1.8e308)";
    return is + ", which is not a number";
}

// Reads a row of the shape; what is wrong with it, if anything.
std::optional<std::string> readRow(const TextShape& shape, std::string_view text, double* out)
{
    FieldSplitter splitter(withoutComment(text), shape.separator);
    std::optional<std::string> fault;
    std::size_t width = 0;
    for (std::string_view field; splitter.next(field); ++width) {
        for (int k = 0; k < 3; ++k) {
            if (shape.columns[k] != width) continue;
            const NumberText read = readNumber(field, out[k]);
            if (read != NumberText::kNumber && !fault) fault = columnFault(shape.columns[k], field, read);
        }
    }
    if (width != shape.width) {
        return "has " + std::to_string(width) + " columns, and the first row has " +
               std::to_string(shape.width);
    }
    return fault;
}

void readChunk(const TextShape& shape, Chunk& chunk, double* out)
{
    out += 3 * chunk.firstRow;
    forEachRow(chunk.begin, chunk.end, [&](const char* line, std::string_view text) {
        if (std::optional<std::string> what = readRow(shape, text, out)) {
            chunk.fault = Fault{line, std::move(*what)};
            return false;
        }
        out += 3;
        return true;
    });
}

std::vector<Chunk> cutIntoChunks(const char* begin, const char* end)
{
    std::vector<Chunk> chunks;
    while (begin != end) {
        const char* cut = end;
        if (static_cast<std::size_t>(end - begin) > kChunkBytes)
            cut = afterLineEnd(findLineEnd(begin + kChunkBytes, end), end);
        chunks.push_back({begin, cut, 0, 0, std::nullopt});
        begin = cut;
    }
    return chunks;
}

} // namespace

ReadArray parseText(const ArrayFile& file)
{
    const char* const begin = reinterpret_cast<const char*>(file.bytes.data());
    TextShape shape = findTextShape(file);
    std::vector<Chunk> chunks = cutIntoChunks(shape.begin, shape.end);
    const auto forEachChunk = [&](const auto& use) {
        tbb::parallel_for(std::size_t(0), chunks.size(), [&](std::size_t i) {
            file.cancel.check();
            use(chunks[i]);
        });
    };
    forEachChunk([](Chunk& chunk) {
        forEachRow(chunk.begin, chunk.end, [&](const char*, std::string_view) { return ++chunk.rows > 0; });
    });
    std::size_t rows = 0;
    for (Chunk& chunk : chunks) {
        chunk.firstRow = rows;
        rows += chunk.rows;
    }
    if (rows > kMaxFilePoints) {
        throw InputError(file.path + ": " + std::to_string(rows) + " points are more than the " +
                         std::to_string(kMaxFilePoints) + " that fit; split the file");
    }
    if (shape.count && *shape.count != rows) {
        throw InputError(file.path + ": line " + std::to_string(shape.countLine) + " counts " +
                         std::to_string(*shape.count) + " points, and " + std::to_string(rows) +
                         " rows follow; correct the count or leave it out");
    }
    checkPointsFit(file.path, rows * 3 * sizeof(double), file.allowedBytes);
    ReadArray result;
    result.positions.doubles.resize(3 * rows);
    forEachChunk([&](Chunk& chunk) { readChunk(shape, chunk, result.positions.doubles.data()); });
    for (const Chunk& chunk : chunks) {
        if (!chunk.fault) continue;
        const char* const line = chunk.fault->line;
        const char* const lineEnd = findLineEnd(line, shape.end);
        throw InputError(
            file.path + ": line " + std::to_string(lineNumber(begin, line)) + " (byte " +
            std::to_string(line - begin) + ") " + chunk.fault->what + ": '" +
            shownText({line, static_cast<std::size_t>(lineEnd - line)}) +
            "'; a row is x y z, with blanks, tabs, commas or semicolons between, and other columns "
            "are chosen with --columns");
    }
    result.taken = std::move(shape.taken);
    result.notes = std::move(shape.notes);
    return result;
}

} // namespace vdb_nns
