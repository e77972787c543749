// Bodies of ascii .ply files. A row is a line: cut at line ends into chunks, whose lines are counted, so that
// each chunk knows the number of its first row, and then read in parallel to where they belong. Blank lines
// are no rows.
#include "io/fixed_rows.h"
#include "io/ply_body.h"
#include "io/text_rows.h"
#include "util/memory.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <optional>

namespace vdb_nns {

namespace {

// Large enough that a chunk's start-up is nothing, small enough to share the work of a file of some MB.
constexpr std::size_t kChunkBytes = std::size_t(1) << 20;
// The place of a property that is not read; at most three are.
constexpr std::size_t kNotWanted = 3;

struct Fault {
    const char* line;
    std::string what; // about the line
};

struct Chunk {
    const char* begin;
    const char* end;
    std::uint64_t lines;
    std::uint64_t firstRow;
    std::optional<Fault> fault, laterFault; // the first one, up to the last vertex and behind it
    const char* behindVertices;             // lines, if they are in this chunk
    const char* behindAll;
};

const char* skipBlanks(const char* next, const char* end)
{
    while (next != end && isBlank(*next)) ++next;
    return next;
}

const char* skipValue(const char* next, const char* end)
{
    while (next != end && !isBlank(*next)) ++next;
    return next;
}

std::uint64_t countValues(const char* next, const char* end)
{
    std::uint64_t count = 0;
    for (next = skipBlanks(next, end); next != end; ++count) next = skipBlanks(skipValue(next, end), end);
    return count;
}

bool readLength(const char*& next, const char* end, std::uint64_t& length)
{
    const char* const last = skipValue(next, end);
    const std::from_chars_result result = std::from_chars(next, last, length);
    if (result.ec != std::errc() || result.ptr != last) return false;
    next = last;
    return true;
}

std::string quoted(const char* begin, const char* end)
{
    return "'" + shownText({begin, static_cast<std::size_t>(end - begin)}) + "'";
}

std::string counted(std::uint64_t count, const char* what)
{
    return std::to_string(count) + " " + what + (count == 1 ? "" : "s");
}

class TextBody {
public:
    explicit TextBody(const PlyBody& body)
        : mBody(body),
          mFile(body.file),
          mFileBegin(reinterpret_cast<const char*>(body.file.bytes.data())),
          mEnd(mFileBegin + body.file.bytes.size()),
          mLineEnd(body.header.lineEnd),
          mWidth(body.width()),
          mPlaceOf(body.vertexElement().properties.size(), kNotWanted)
    {
        for (std::size_t k = 0; k < mWidth; ++k) mPlaceOf[body.property[k]] = k;
    }

    ReadArray read()
    {
        cutIntoChunks();
        forEachChunk([&](Chunk& chunk) {
            forEachLine(chunk, [&](const char*, const char*) {
                ++chunk.lines;
                return true;
            });
        });
        std::uint64_t lines = 0;
        for (Chunk& chunk : mChunks) {
            chunk.firstRow = lines;
            lines += chunk.lines;
        }
        layOutRows(lines);
        checkPointCount(mFile, vertex().count, mBody.isDouble, mWidth);
        ReadArray result;
        if (mBody.isDouble) {
            readRows(result.positions.doubles);
        } else {
            readRows(result.positions.floats);
        }
        checkLaterRows(lines, result);
        return result;
    }

private:
    const PlyElement& vertex() const { return mBody.vertexElement(); }

    // ---------------------------------------------------------------------------------------- lines

    void cutIntoChunks()
    {
        for (const char* begin = mFileBegin + mBody.header.bytes; begin != mEnd;) {
            const char* cut = mEnd;
            if (static_cast<std::size_t>(mEnd - begin) > kChunkBytes) {
                cut = findEndOfLine(begin + kChunkBytes, mEnd);
                if (cut != mEnd) ++cut;
            }
            mChunks.push_back({begin, cut, 0, 0, {}, {}, nullptr, nullptr});
            begin = cut;
        }
    }

    template <typename Use>
    void forEachChunk(const Use& use)
    {
        tbb::parallel_for(std::size_t(0), mChunks.size(), [&](std::size_t i) {
            mFile.cancel.check();
            use(mChunks[i]);
        });
    }

    const char* findEndOfLine(const char* next, const char* end) const
    {
        const void* const found = std::memchr(next, mLineEnd, static_cast<std::size_t>(end - next));
        return found ? static_cast<const char*>(found) : end;
    }

    // Calls use(first, end) with the first value and the end of each line that is not blank, until it returns
    // false.
    template <typename Use>
    void forEachLine(const Chunk& chunk, const Use& use) const
    {
        for (const char* line = chunk.begin; line != chunk.end;) {
            const char* const found = findEndOfLine(line, chunk.end);
            const char* end = found;
            if (end != line && end[-1] == '\r') --end;
            const char* const first = skipBlanks(line, end);
            if (first != end && !use(first, end)) return;
            line = found == chunk.end ? found : found + 1;
        }
    }

    // ---------------------------------------------------------------------------------------- rows

    // The number of the first row of each element, and behind the last one's.
    void layOutRows(std::uint64_t lines)
    {
        std::uint64_t rows = 0;
        for (std::size_t i = 0; i < mBody.header.elements.size(); ++i) {
            const PlyElement& element = mBody.header.elements[i];
            mFirstRow.push_back(rows);
            const std::uint64_t count = element.properties.empty() ? 0 : element.count;
            if (count > lines - rows) {
                if (i <= mBody.vertex) failTruncated(element, lines - rows);
                mIsCut = true;
            }
            rows += std::min(count, lines - rows);
        }
        mFirstRow.push_back(rows);
    }

    [[noreturn]] void failTruncated(const PlyElement& element, std::uint64_t lines) const
    {
        throw InputError(mFile.path + ": the .ply header promises " + std::to_string(element.count) +
                         " rows of element '" + shownText(element.name) +
                         "', one a line, but the file has only " + std::to_string(lines) +
                         " lines for them and ends at byte " + std::to_string(mFile.bytes.size()) +
                         "; it is truncated or its header is wrong");
    }

    template <typename Real>
    void readRows(std::vector<Real>& out)
    {
        resizeOnHugePages(out, static_cast<std::size_t>(vertex().count) * mWidth);
        forEachChunk([&](Chunk& chunk) { readChunk(chunk, out.data()); });
        for (const Chunk& chunk : mChunks) {
            if (chunk.fault) failAtLine(chunk.fault->line, chunk.fault->what);
        }
    }

    template <typename Real>
    void readChunk(Chunk& chunk, Real* out) const
    {
        const std::uint64_t firstVertex = mFirstRow[mBody.vertex],
                            behindVertices = mFirstRow[mBody.vertex + 1];
        std::uint64_t row = chunk.firstRow;
        std::size_t element = 0;
        forEachLine(chunk, [&](const char* first, const char* end) {
            if (row == behindVertices) chunk.behindVertices = first;
            if (row == mFirstRow.back()) {
                chunk.behindAll = first;
                return false;
            }
            while (row >= mFirstRow[element + 1]) ++element;
            const bool isVertex = element == mBody.vertex;
            std::optional<Fault> fault;
            if (isVertex && !vertex().hasLists()) {
                readVertex(first, end, out + mWidth * (row - firstVertex), fault);
            } else {
                readRow(mBody.header.elements[element], first, end,
                        isVertex ? out + mWidth * (row - firstVertex) : nullptr, fault);
            }
            ++row;
            if (!fault) return true;
            if (element > mBody.vertex) {
                if (!chunk.laterFault) chunk.laterFault = std::move(fault);
                return true;
            }
            chunk.fault = std::move(fault);
            return false;
        });
    }

    // A row without lists. Values that are not wanted are counted and not looked at.
    template <typename Real>
    void readVertex(const char* const first, const char* end, Real* out, std::optional<Fault>& fault) const
    {
        const char* next = first;
        for (std::size_t i = 0; i < mPlaceOf.size(); ++i) {
            if (next == end) return setWidthFault(vertex(), first, end, nullptr, fault);
            if (mPlaceOf[i] != kNotWanted) {
                if (!readWanted(first, next, end, i, out, fault)) return;
            } else {
                next = skipValue(next, end);
            }
            next = skipBlanks(next, end);
        }
        if (next != end) setWidthFault(vertex(), first, end, next, fault);
    }

    template <typename Real>
    bool readWanted(const char* first, const char*& next, const char* end, std::size_t property, Real* out,
                    std::optional<Fault>& fault) const
    {
        const PlyProperty& p = vertex().properties[property];
        const char* const what = readTextNumber(p.type, next, end, out[mPlaceOf[property]]);
        if (!what) return true;
        fault = Fault{first, ": " + quoted(next, skipValue(next, end)) + " " + what + "; expected property " +
                                 shownText(p.name) +
                                 " of element 'vertex', a number of the type that the header declares"};
        return false;
    }

    // A row of any element; `out` is null unless it is a vertex.
    template <typename Real>
    void readRow(const PlyElement& element, const char* const first, const char* end, Real* out,
                 std::optional<Fault>& fault) const
    {
        const char* next = first;
        for (std::size_t i = 0; i < element.properties.size(); ++i) {
            if (next == end) return setWidthFault(element, first, end, nullptr, fault);
            std::uint64_t values = 1;
            if (element.properties[i].isList) {
                const char* const length = next;
                if (!readLength(next, end, values)) {
                    fault = Fault{first, ": " + quoted(length, skipValue(length, end)) +
                                             " is not the length of a list, as property " +
                                             shownText(element.properties[i].name) + " of element '" +
                                             shownText(element.name) + "' begins with"};
                    return;
                }
                next = skipBlanks(next, end);
            } else if (out && mPlaceOf[i] != kNotWanted) {
                if (!readWanted(first, next, end, i, out, fault)) return;
                next = skipBlanks(next, end);
                continue;
            }
            for (; values > 0; --values) {
                if (next == end) return setWidthFault(element, first, end, nullptr, fault);
                next = skipBlanks(skipValue(next, end), end);
            }
        }
        if (next != end) setWidthFault(element, first, end, next, fault);
    }

    // `surplus` is what stands behind the last value; null where values are missing.
    void setWidthFault(const PlyElement& element, const char* first, const char* end, const char* surplus,
                       std::optional<Fault>& fault) const
    {
        std::string what = " has " + counted(countValues(first, end), "value") + ": " + quoted(first, end) +
                           "; the header declares ";
        if (element.hasLists()) {
            what += surplus ? "fewer, lists included," : "more, lists included,";
        } else {
            what += std::to_string(element.properties.size());
        }
        what += " for a row of element '" + shownText(element.name) + "', one row a line (";
        for (std::size_t i = 0; i < element.properties.size() && i < 16; ++i)
            what += (i ? " " : "") + shownText(element.properties[i].name);
        what += ")";
        if (surplus) {
            what += "; left over behind the last one: " + counted(countValues(surplus, end), "value") + ", " +
                    counted(static_cast<std::uint64_t>(end - surplus), "byte") +
                    "; write a header that declares all there is";
        } else if (end == mEnd) {
            what += "; the file is truncated";
        }
        fault = Fault{first, std::move(what)};
    }

    // ---------------------------------------------------------------------------------------- behind the
    // vertices

    void checkLaterRows(std::uint64_t lines, ReadArray& result) const
    {
        const char* behindVertices = nullptr;
        const char* behindAll = nullptr;
        const Fault* fault = nullptr;
        for (const Chunk& chunk : mChunks) {
            if (chunk.behindVertices) behindVertices = chunk.behindVertices;
            if (chunk.behindAll) behindAll = chunk.behindAll;
            if (chunk.laterFault && !fault) fault = &*chunk.laterFault;
        }
        if (fault && fault->line == behindVertices && looksLikeVertex(fault->line)) {
            failAtLine(fault->line,
                       " stands behind the last of " + std::to_string(vertex().count) +
                           " vertices that the .ply header declares and looks like one more; " +
                           std::to_string(mEnd - fault->line) +
                           " bytes are left over from there on; correct the count of the header");
        }
        if (lines > mFirstRow.back()) {
            // Rows of later elements may be broken into lines.
            if (behindVertices == behindAll || !valuesEndAtFile(behindVertices))
                failLeftOver(behindAll, lines);
        } else if (mIsCut) {
            result.notes.push_back(forgivenNote(mBody,
                                                "the file ends before the rows that its header promises",
                                                "byte " + std::to_string(mFile.bytes.size())));
        } else if (fault) {
            result.notes.push_back(forgivenNote(mBody, "a row of another width than declared",
                                                "line " + std::to_string(lineNumberOf(fault->line)) +
                                                    ", byte " + std::to_string(fault->line - mFileBegin)));
        }
    }

    const char* endOfLineAt(const char* line) const
    {
        const char* const end = findEndOfLine(line, mEnd);
        return end != line && end[-1] == '\r' ? end - 1 : end;
    }

    // As many numbers as a vertex has, one of which is no integer, where only integers are declared.
    bool looksLikeVertex(const char* line) const
    {
        const PlyElement& element = elementBehindVertices();
        const char* const end = endOfLineAt(line);
        if (vertex().hasLists() || countValues(line, end) != vertex().properties.size()) return false;
        for (const PlyProperty& property : element.properties) {
            if (isReal(property.type)) return false;
        }
        bool hasReal = false;
        for (const char* next = line; next != end; next = skipBlanks(next, end)) {
            std::int64_t integer = 0;
            double real = 0;
            if (!readTextNumber<std::int64_t>(next, end, integer)) continue;
            if (readTextNumber<double>(next, end, real)) return false;
            hasReal = true;
        }
        return hasReal;
    }

    const PlyElement& elementBehindVertices() const
    {
        std::size_t i = mBody.vertex + 1;
        while (mFirstRow[i + 1] == mFirstRow[mBody.vertex + 1]) ++i; // a row that is at fault belongs to one
        return mBody.header.elements[i];
    }

    // Whether the values of the later elements are as many as declared, wherever their lines end.
    bool valuesEndAtFile(const char* next) const
    {
        const auto skipOne = [&] {
            while (next != mEnd && isTextSpace(*next)) ++next;
            const bool isThere = next != mEnd;
            next = endOfToken(next, mEnd);
            return isThere;
        };
        for (std::size_t i = mBody.vertex + 1; i < mBody.header.elements.size(); ++i) {
            const PlyElement& element = mBody.header.elements[i];
            for (std::uint64_t row = 0; row < element.count && !element.properties.empty(); ++row) {
                if (row % 65536 == 0) mFile.cancel.check();
                for (const PlyProperty& property : element.properties) {
                    if (!skipOne()) return false;
                    if (!property.isList) continue;
                    const char* token = next;
                    while (!isTextSpace(token[-1])) --token;
                    std::uint64_t length = 0;
                    if (!readLength(token, next, length)) return false;
                    for (; length > 0; --length) {
                        if (!skipOne()) return false;
                    }
                }
            }
        }
        return !skipOne();
    }

    [[noreturn]] void failLeftOver(const char* line, std::uint64_t lines) const
    {
        failAtLine(line, ", " + quoted(line, endOfLineAt(line)) +
                             ", stands behind the last row that the .ply header declares: " +
                             counted(lines - mFirstRow.back(), "line") + ", " +
                             counted(static_cast<std::uint64_t>(mEnd - line), "byte") +
                             ", left over behind " + counted(mFirstRow.back(), "row") +
                             "; correct the counts of the header");
    }

    std::uint64_t lineNumberOf(const char* place) const
    {
        return 1 + static_cast<std::uint64_t>(std::count(mFileBegin, place, mLineEnd));
    }

    [[noreturn]] void failAtLine(const char* line, const std::string& what) const
    {
        throw InputError(mFile.path + ": line " + std::to_string(lineNumberOf(line)) + " (byte " +
                         std::to_string(line - mFileBegin) + ")" + what);
    }

    const PlyBody& mBody;
    const ArrayFile& mFile;
    const char* const mFileBegin;
    const char* const mEnd;
    const char mLineEnd;
    const std::size_t mWidth;             // numbers that are read of a vertex
    std::vector<std::size_t> mPlaceOf;    // among them, of each property of a vertex
    std::vector<std::uint64_t> mFirstRow; // of each element, and behind all
    bool mIsCut = false;                  // rows behind the vertices are missing
    std::vector<Chunk> mChunks;
};

} // namespace

ReadArray readPlyText(const PlyBody& body)
{
    return TextBody(body).read();
}

} // namespace vdb_nns
