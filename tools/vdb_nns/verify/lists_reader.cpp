// See lists_reader.h.
#include "lists_reader.h"

#include "vdb_nns/error.h"
#include "zip_members.h"

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <vector>

namespace vdb_nns::cli {

namespace {

class Mapping {
public:
    explicit Mapping(const std::string& path)
    {
        const int descriptor = ::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
        if (descriptor < 0) throw InputError(path + ": cannot be opened: " + std::strerror(errno));
        struct stat status {};
        const bool regular = ::fstat(descriptor, &status) == 0 && S_ISREG(status.st_mode);
        if (regular && status.st_size > 0) {
            const auto size = static_cast<std::size_t>(status.st_size);
            void* address = ::mmap(nullptr, size, PROT_READ, MAP_PRIVATE, descriptor, 0);
            if (address != MAP_FAILED) {
                mRange = {static_cast<const unsigned char*>(address), size};
            } else if (errno == ENOMEM) {
                ::close(descriptor);
                throw CapacityError(path + ": its " + std::to_string(size) + " bytes do not fit the memory",
                                    size, 0);
            }
        }
        ::close(descriptor);
        if (!regular) throw InputError(path + ": is not a regular file");
        if (!mRange.data) throw InputError(path + ": is empty or cannot be mapped");
    }
    ~Mapping() { ::munmap(const_cast<unsigned char*>(mRange.data), mRange.size); }
    Mapping(const Mapping&) = delete;
    Mapping& operator=(const Mapping&) = delete;

    ByteRange range() const { return mRange; }

private:
    ByteRange mRange;
};

// One array of the archive; its bytes need not be aligned.
struct Array {
    std::string type; // NumPy's descr, e.g. "<i8"
    std::vector<std::uint64_t> shape;
    const unsigned char* data = nullptr;
    std::uint64_t size = 1; // elements
};

template <typename T>
T load(const unsigned char* data, std::uint64_t index)
{
    T value;
    std::memcpy(&value, data + index * sizeof(T), sizeof(T));
    return value;
}

class ArrayParser {
public:
    ArrayParser(const std::string& path, const std::string& name, ByteRange bytes)
        : mWhere(path + ": array '" + name + "' "), mBytes(bytes)
    {
    }

    // `elementBytes` maps the accepted types to their size.
    Array parse(const std::map<std::string, std::uint64_t>& elementBytes) const
    {
        const std::uint64_t headerEnd = headerRange();
        const std::uint64_t start = mBytes.data[6] == 1 ? 10 : 12;
        const std::string header(reinterpret_cast<const char*>(mBytes.data) + start, headerEnd - start);
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
        array.data = mBytes.data + headerEnd;
        return array;
    }

private:
    [[noreturn]] void fail(const std::string& what) const { throw InputError(mWhere + what); }

    // NumPy's format, versions 1 to 3: magic, two bytes of version, the length of the header in 2 or 4 bytes.
    std::uint64_t headerRange() const
    {
        if (mBytes.size < 12 || std::memcmp(mBytes.data, "\x93NUMPY", 6) != 0) fail("is not a .npy array");
        if (mBytes.data[6] < 1 || mBytes.data[6] > 3) fail("has an unknown version of the .npy format");
        const std::uint64_t end = mBytes.data[6] == 1
                                      ? 10 + std::uint64_t(load<std::uint16_t>(mBytes.data + 8, 0))
                                      : 12 + std::uint64_t(load<std::uint32_t>(mBytes.data + 8, 0));
        if (end < 12 || end > mBytes.size) fail("has a header that is cut off");
        return end;
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

    std::string mWhere;
    ByteRange mBytes;
};

} // namespace

struct ListsFile::Data {
    explicit Data(const std::string& file) : path(file), mapping(file) {}

    std::string path;
    Mapping mapping;
    const unsigned char *offsets = nullptr, *indices = nullptr, *values = nullptr;
    std::uint64_t rows = 0, pairs = 0;
    bool wideOffsets = false, wideIndices = false, distances = false;

    std::int64_t offset(std::uint64_t i) const
    {
        return wideOffsets ? load<std::int64_t>(offsets, i) : load<std::int32_t>(offsets, i);
    }

    void readArrays();
    void checkOffsets() const;
};

void ListsFile::Data::readArrays()
{
    const auto members = zipMembers(path, mapping.range());
    const auto array = [&](const std::string& name, const std::map<std::string, std::uint64_t>& types,
                           std::size_t dimensions) {
        const auto member = members.find(name + ".npy");
        if (member == members.end()) throw InputError(path + ": has no array '" + name + "'");
        const Array parsed = ArrayParser(path, name, member->second).parse(types);
        if (parsed.shape.size() == dimensions) return parsed;
        throw InputError(path + ": array '" + name + "' has " + std::to_string(parsed.shape.size()) +
                         " dimensions");
    };
    const Array format = array("format", {{"|S3", 3}, {"S3", 3}}, 0);
    if (std::memcmp(format.data, "csr", 3) != 0) throw InputError(path + ": is not a matrix in CSR format");
    const Array shape = array("shape", {{"<i8", 8}}, 1);
    const Array starts = array("indptr", {{"<i4", 4}, {"<i8", 8}}, 1);
    const Array numbers = array("indices", {{"<i4", 4}, {"<i8", 8}}, 1);
    const Array data = array("data", {{"|i1", 1}, {"<f4", 4}}, 1);
    rows = starts.size - 1; // wraps for an empty indptr, which the next test refuses
    if (starts.size == 0 || shape.size != 2 || load<std::uint64_t>(shape.data, 0) != rows ||
        load<std::uint64_t>(shape.data, 1) != rows) {
        throw InputError(path + ": 'shape' is not that of a square matrix with the rows of 'indptr'");
    }
    pairs = numbers.size;
    if (data.size != pairs) throw InputError(path + ": 'data' and 'indices' differ in length");
    offsets = starts.data;
    indices = numbers.data;
    values = data.data;
    wideOffsets = starts.type == "<i8";
    wideIndices = numbers.type == "<i8";
    distances = data.type == "<f4";
}

void ListsFile::Data::checkOffsets() const
{
    std::int64_t last = 0;
    if (offset(0) != 0) throw InputError(path + ": 'indptr' does not begin with 0");
    for (std::uint64_t i = 1; i <= rows; ++i) {
        const std::int64_t next = offset(i);
        if (next < last) throw InputError(path + ": 'indptr' decreases at " + std::to_string(i));
        last = next;
    }
    if (static_cast<std::uint64_t>(last) != pairs) {
        throw InputError(path + ": 'indptr' ends with " + std::to_string(last) + ", but there are " +
                         std::to_string(pairs) + " indices");
    }
}

ListsFile ListsFile::open(const std::string& path)
{
    const auto data = std::make_shared<Data>(path);
    data->readArrays();
    data->checkOffsets();
    ListsFile file;
    file.mData = data;
    return file;
}

const std::string& ListsFile::path() const
{
    return mData->path;
}
std::uint64_t ListsFile::rowCount() const
{
    return mData->rows;
}
std::uint64_t ListsFile::pairCount() const
{
    return mData->pairs;
}
bool ListsFile::holdsDistances() const
{
    return mData->distances;
}

std::uint64_t ListsFile::rowBegin(std::uint64_t i) const
{
    return static_cast<std::uint64_t>(mData->offset(i));
}

void ListsFile::readRow(std::uint64_t i, std::vector<std::int64_t>& neighbors,
                        std::vector<float>& values) const
{
    const std::uint64_t begin = rowBegin(i), count = rowBegin(i + 1) - begin;
    neighbors.resize(count);
    values.resize(count);
    const auto copy = [&](auto type, const unsigned char* from, auto& to) {
        for (std::uint64_t k = 0; k < count; ++k) {
            to[k] = static_cast<std::decay_t<decltype(to[k])>>(load<decltype(type)>(from, begin + k));
        }
    };
    mData->wideIndices ? copy(std::int64_t(), mData->indices, neighbors)
                       : copy(std::int32_t(), mData->indices, neighbors);
    mData->distances ? copy(float(), mData->values, values) : copy(std::int8_t(), mData->values, values);
}

} // namespace vdb_nns::cli
