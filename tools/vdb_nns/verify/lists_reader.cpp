#include "lists_reader.h"

#include "file_pieces.h"
#include "throw_if_cancelled.h"
#include "vdb_nns/error.h"
#include "zip_members.h"

#include <tbb/enumerable_thread_specific.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <vector>

namespace vdb_nns::cli {

namespace {

// No header of a list is longer.
constexpr std::uint64_t kMostHeaderBytes = std::uint64_t(1) << 20;
// Elements that are read at once where all are.
constexpr std::uint64_t kBlockElements = std::uint64_t(1) << 16;
// What a thread keeps of each array. Small blocks, as rows in random order find none of them again; enough of them for the
// rows of a leaf with some 20 neighbors each.
constexpr std::uint64_t kCachedElements = 1024, kCachedBlocks = 128;

// One array of the archive.
struct Array {
    std::string type; // NumPy's descr, e.g. "<i8"
    std::vector<std::uint64_t> shape;
    std::uint64_t begin = 0; // byte of the file
    std::uint64_t size = 1;  // elements
};

// Elements [first, first + count) of an array of T, converted.
template <typename T, typename To>
void readElements(const FilePieces& file, const Array& array, std::uint64_t first, std::uint64_t count,
                  To* out)
{
    std::array<T, 1024> raw;
    while (count > 0) {
        const std::uint64_t n = std::min<std::uint64_t>(count, raw.size());
        file.read(array.begin + first * sizeof(T), raw.data(), n * sizeof(T));
        for (std::uint64_t k = 0; k < n; ++k) out[k] = static_cast<To>(raw[k]);
        first += n;
        count -= n;
        out += n;
    }
}

// The same for arrays of int32 or int64.
void readIntegers(const FilePieces& file, const Array& array, std::uint64_t first, std::uint64_t count,
                  std::int64_t* out)
{
    if (array.type == "<i8") {
        readElements<std::int64_t>(file, array, first, count, out);
    } else {
        readElements<std::int32_t>(file, array, first, count, out);
    }
}

class ArrayParser {
public:
    ArrayParser(const FilePieces& file, const std::string& name, ByteRange bytes)
        : mFile(file), mWhere(file.path() + ": array '" + name + "' "), mBytes(bytes)
    {
    }

    // `elementBytes` maps the accepted types to their size.
    Array parse(const std::map<std::string, std::uint64_t>& elementBytes) const
    {
        const ByteRange range = headerRange();
        const std::uint64_t headerEnd = range.begin + range.size;
        std::string header(range.size, '\0');
        mFile.read(mBytes.begin + range.begin, header.data(), header.size());
        Array array;
        array.type = between(header, "'descr'", '\'', '\'');
        const auto known = elementBytes.find(array.type);
        if (known == elementBytes.end()) fail("has the type '" + array.type + "', which lists do not have");
        if (header.find("'fortran_order': False") == std::string::npos) fail("is not in C order");
        array.shape = numbers(between(header, "'shape'", '(', ')'));
        for (const std::uint64_t edge : array.shape) {
            if (edge && array.size > mBytes.size / edge) fail("claims more elements than it has bytes");
            array.size *= edge;
        }
        if (array.size * known->second != mBytes.size - headerEnd)
            fail("has another size than its header says");
        array.begin = mBytes.begin + headerEnd;
        return array;
    }

private:
    [[noreturn]] void fail(const std::string& what) const { throw InputError(mWhere + what); }

    // NumPy's format, versions 1 to 3: magic, two bytes of version, the length of the header in 2 or 4 bytes.
    ByteRange headerRange() const
    {
        std::array<unsigned char, 12> start{};
        if (mBytes.size >= start.size()) mFile.read(mBytes.begin, start.data(), start.size());
        if (std::memcmp(start.data(), "\x93NUMPY", 6) != 0) fail("is not a .npy array");
        if (start[6] < 1 || start[6] > 3) fail("has an unknown version of the .npy format");
        ByteRange header{start[6] == 1 ? std::uint64_t(10) : 12, start[8] + std::uint64_t(start[9]) * 256};
        if (start[6] != 1) header.size += std::uint64_t(start[10]) << 16 | std::uint64_t(start[11]) << 24;
        if (header.size < 2 || header.begin + header.size > mBytes.size) fail("has a header that is cut off");
        if (header.size > kMostHeaderBytes) fail("has a header of absurd size");
        return header;
    }

    std::string between(const std::string& header, const char* key, char open, char close) const
    {
        const std::size_t at = header.find(key);
        const std::size_t begin = at == std::string::npos ? at : header.find(open, at + std::strlen(key));
        const std::size_t end = begin == std::string::npos ? begin : header.find(close, begin + 1);
        if (end == std::string::npos) fail(std::string("has no ") + key + " in its header");
        return header.substr(begin + 1, end - begin - 1);
    }

    std::vector<std::uint64_t> numbers(const std::string& text) const
    {
        std::vector<std::uint64_t> values;
        bool inside = false;
        for (const char c : text) {
            if (c >= '0' && c <= '9') {
                if (!inside) values.push_back(0);
                if (values.back() > (std::uint64_t(1) << 59)) fail("has a shape of absurd size");
                values.back() = values.back() * 10 + static_cast<std::uint64_t>(c - '0');
                inside = true;
            } else if (c == ',' || c == ' ') {
                inside = false;
            } else {
                fail("has a shape that is not a tuple of numbers");
            }
        }
        return values;
    }

    const FilePieces& mFile;
    std::string mWhere;
    ByteRange mBytes;
};

// What a thread has read of an array. Rows are asked for cell by cell, so that the next one is near one of the last.
template <typename T>
class BlockCache {
public:
    // Copies elements [first, first + count) of an array of `size`; read(first, count, out) gets those that are not here.
    template <typename Read>
    void copy(std::uint64_t first, std::uint64_t count, std::uint64_t size, T* out, const Read& read)
    {
        while (count > 0) {
            const std::uint64_t number = first / kCachedElements, begin = number * kCachedElements;
            Block& block = mBlocks[number % mBlocks.size()];
            if (block.elements.empty() || block.number != number) {
                block.number = number;
                block.elements.resize(std::min(kCachedElements, size - begin));
                read(begin, block.elements.size(), block.elements.data());
            }
            const std::uint64_t n = std::min(count, begin + block.elements.size() - first);
            std::copy_n(block.elements.begin() + static_cast<std::ptrdiff_t>(first - begin), n, out);
            first += n;
            count -= n;
            out += n;
        }
    }

private:
    struct Block {
        std::uint64_t number = 0;
        std::vector<T> elements;
    };
    std::array<Block, kCachedBlocks> mBlocks;
};

struct RowCache {
    BlockCache<std::int64_t> offsets, indices;
    BlockCache<float> values;
};

} // namespace

struct ListsFile::Data {
    explicit Data(const std::string& path) : file(path) {}

    FilePieces file;
    Array offsets, indices, values;
    std::uint64_t rows = 0, columns = 0, pairs = 0;
    mutable tbb::enumerable_thread_specific<RowCache> caches;

    void readArrays(const Progress* progress);
    void checkOffsets(const Progress* progress) const;
};

void ListsFile::Data::readArrays(const Progress* progress)
{
    const std::string& path = file.path();
    const auto members = zipMembers(file, progress);
    const auto array = [&](const std::string& name, const std::map<std::string, std::uint64_t>& types,
                           std::size_t dimensions) {
        const auto member = members.find(name + ".npy");
        if (member == members.end()) throw InputError(path + ": has no array '" + name + "'");
        const Array parsed = ArrayParser(file, name, member->second).parse(types);
        if (parsed.shape.size() == dimensions) return parsed;
        throw InputError(path + ": array '" + name + "' has " + std::to_string(parsed.shape.size()) +
                         " dimensions");
    };
    std::array<char, 3> format;
    file.read(array("format", {{"|S3", 3}, {"S3", 3}}, 0).begin, format.data(), format.size());
    if (std::memcmp(format.data(), "csr", 3) != 0) throw InputError(path + ": is not a matrix in CSR format");
    const Array shape = array("shape", {{"<i8", 8}}, 1);
    offsets = array("indptr", {{"<i4", 4}, {"<i8", 8}}, 1);
    indices = array("indices", {{"<i4", 4}, {"<i8", 8}}, 1);
    values = array("data", {{"|i1", 1}, {"<f4", 4}}, 1);
    std::array<std::uint64_t, 2> edges{};
    if (shape.size == edges.size()) readElements<std::uint64_t>(file, shape, 0, edges.size(), edges.data());
    rows = offsets.size - 1; // wraps for an empty indptr, which the next test refuses
    if (offsets.size == 0 || shape.size != edges.size() || edges[0] != rows || edges[1] >> 63) {
        throw InputError(path + ": 'shape' is not that of a matrix with the rows of 'indptr'");
    }
    columns = edges[1];
    pairs = indices.size;
    if (values.size != pairs) throw InputError(path + ": 'data' and 'indices' differ in length");
}

void ListsFile::Data::checkOffsets(const Progress* progress) const
{
    const std::string& path = file.path();
    std::int64_t last = 0;
    std::vector<std::int64_t> block(std::min(kBlockElements, offsets.size));
    for (std::uint64_t first = 0; first < offsets.size; first += block.size()) {
        throwIfCancelled(progress);
        block.resize(std::min<std::uint64_t>(block.size(), offsets.size - first));
        readIntegers(file, offsets, first, block.size(), block.data());
        if (first == 0 && block[0] != 0) throw InputError(path + ": 'indptr' does not begin with 0");
        for (std::size_t k = 0; k < block.size(); ++k) {
            if (block[k] < last) {
                throw InputError(path + ": 'indptr' decreases at " + std::to_string(first + k));
            }
            last = block[k];
        }
    }
    if (static_cast<std::uint64_t>(last) != pairs) {
        throw InputError(path + ": 'indptr' ends with " + std::to_string(last) + ", but there are " +
                         std::to_string(pairs) + " indices");
    }
}

ListsFile ListsFile::open(const std::string& path, const Progress* progress)
{
    const auto data = std::make_shared<Data>(path);
    data->readArrays(progress);
    data->checkOffsets(progress);
    ListsFile file;
    file.mData = data;
    return file;
}

const std::string& ListsFile::path() const
{
    return mData->file.path();
}
std::uint64_t ListsFile::rowCount() const
{
    return mData->rows;
}
std::uint64_t ListsFile::columnCount() const
{
    return mData->columns;
}
std::uint64_t ListsFile::pairCount() const
{
    return mData->pairs;
}
bool ListsFile::holdsDistances() const
{
    return mData->values.type == "<f4";
}

void ListsFile::readRow(std::uint64_t i, std::vector<std::int64_t>& neighbors,
                        std::vector<float>& values) const
{
    const Data& data = *mData;
    RowCache& cache = data.caches.local();
    const auto integersOf = [&](const Array& array) {
        return [&](std::uint64_t first, std::uint64_t count, std::int64_t* out) {
            readIntegers(data.file, array, first, count, out);
        };
    };
    const auto readValues = [&](std::uint64_t first, std::uint64_t count, float* out) {
        if (holdsDistances()) {
            readElements<float>(data.file, data.values, first, count, out);
        } else {
            readElements<std::int8_t>(data.file, data.values, first, count, out);
        }
    };
    std::int64_t ends[2];
    cache.offsets.copy(i, 2, data.offsets.size, ends, integersOf(data.offsets));
    if (ends[0] < 0 || ends[1] < ends[0] || static_cast<std::uint64_t>(ends[1]) > data.pairs) {
        throw InputError(path() + ": has changed while it was read; check it once nobody writes it any more");
    }
    const auto begin = static_cast<std::uint64_t>(ends[0]),
               count = static_cast<std::uint64_t>(ends[1]) - begin;
    neighbors.resize(count);
    values.resize(count);
    cache.indices.copy(begin, count, data.pairs, neighbors.data(), integersOf(data.indices));
    cache.values.copy(begin, count, data.pairs, values.data(), readValues);
}

} // namespace vdb_nns::cli
