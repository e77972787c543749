// NumPy's .npy, versions 1 to 3 (numpy.lib.format): the magic string, a header that is a Python literal, and
// raw values; and .npz, a ZIP of them.
#include "file_numbers.h"
#include "point_formats.h"
#include "vdb_nns/error.h"
#include "zip_members.h"

#include <cctype>
#include <cstdint>
#include <cstdlib>
#include <limits>
#include <memory>
#include <optional>

namespace vdb_nns::cli {

namespace {

// A Python literal. A dictionary's items are its keys and values by turns.
struct Literal {
    char kind = 0; // '{', '[', '(', '\'' for a string, or 0 for a word or number
    std::string text;
    std::vector<Literal> items;
};

class LiteralReader {
public:
    LiteralReader(const PointInput& input, const std::string& text) : mInput(input), mText(text) {}

    Literal read()
    {
        Literal literal = readValue(0);
        skipSpace();
        if (mAt != mText.size()) fail();
        return literal;
    }

private:
    static constexpr int kMostNesting = 8;

    [[noreturn]] void fail() const { mInput.fail("has an .npy header that is no Python literal"); }

    void skipSpace()
    {
        while (mAt < mText.size() && (mText[mAt] == ' ' || mText[mAt] == '\n')) ++mAt;
    }

    char peek()
    {
        skipSpace();
        if (mAt == mText.size()) fail();
        return mText[mAt];
    }

    Literal readValue(int nesting)
    {
        if (nesting > kMostNesting) fail();
        Literal literal;
        const char first = peek();
        if (first == '{' || first == '[' || first == '(') {
            const char close = first == '{' ? '}' : first == '[' ? ']' : ')';
            literal.kind = first;
            ++mAt;
            while (peek() != close) {
                literal.items.push_back(readValue(nesting + 1));
                if (peek() == ',' || (first == '{' && peek() == ':')) ++mAt;
            }
            ++mAt;
        } else if (first == '\'' || first == '"') {
            const std::size_t end = mText.find(first, mAt + 1);
            if (end == std::string::npos) fail();
            literal.kind = '\'';
            literal.text = mText.substr(mAt + 1, end - mAt - 1);
            mAt = end + 1;
        } else {
            while (mAt < mText.size() && std::isalnum(static_cast<unsigned char>(mText[mAt])))
                literal.text += mText[mAt++];
            if (literal.text.empty()) fail();
        }
        return literal;
    }

    const PointInput& mInput;
    const std::string& mText;
    std::size_t mAt = 0;
};

// Where a coordinate of all points is: in bytes from the first value.
struct Column {
    NumberType type;
    bool isBigEndian = false;
    std::uint64_t offset = 0;
};

struct Field {
    std::string name;
    Column column;
    std::uint64_t bytes = 0; // of all its values
    bool isArray = false;
};

class NpyArray {
public:
    NpyArray(const PointInput& input, const std::string& bytes) : mInput(input), mBytes(bytes) {}

    // The one column of an array.
    std::vector<double> readList()
    {
        const Literal header = readHeader();
        for (const Literal& size : valueOf(header, "shape").items) mShape.push_back(sizeOf(size));
        if (mShape.size() != 1 && !(mShape.size() == 2 && mShape[1] == 1))
            fail("has an .npy array that is no list");
        const Column column = columnOf(valueOf(header, "descr").text, mItemBytes);
        checkNumber(column);
        if (column.type.kind != 'f' || column.type.bytes < 4) fail("has an .npy list that is not of floats");
        checkSize();
        std::vector<double> numbers;
        for (std::uint64_t row = 0; row < mShape[0]; ++row) {
            if (row % kRowsBetweenChecks == 0) mInput.checkCancelled();
            numbers.push_back(
                *numberAt(mBytes.data() + mBegin + row * mItemBytes, column.type, column.isBigEndian));
        }
        return numbers;
    }

    // Rows of all numbers.
    PointValues readValues(const std::string& name)
    {
        const Literal header = readHeader();
        for (const Literal& size : valueOf(header, "shape").items) mShape.push_back(sizeOf(size));
        const std::string descr = valueOf(header, "descr").text;
        const bool isGroup = descr == "|b1";
        Column column = columnOf(descr, mItemBytes);
        if (isGroup) column.type.kind = 'u';
        checkNumber(column);
        checkSize();
        std::uint64_t width = 1;
        for (std::size_t k = 1; k < mShape.size(); ++k) width = product(width, mShape[k]);
        const std::optional<AttributeType> type = attributeType(column.type, width);
        const bool isFortran = valueOf(header, "fortran_order").text == "True";
        if (mShape.empty() || (isFortran && width > 1) || (isGroup ? width != 1 : !type))
            fail("has an array '" + name + "' of the .npy type '" + descr + "' with " +
                 std::to_string(width) + " numbers a row, which no attribute has");
        PointValues values;
        if (isGroup) {
            const auto members = numbers<std::uint8_t>(column, 1);
            values.groups.push_back({name, mShape[0], {members, members->data()}});
            return values;
        }
        std::shared_ptr<const void> owned;
        if (column.type.kind == 'f')
            owned = column.type.bytes == 4 ? owner<float>(column, width) : owner<double>(column, width);
        else
            owned = column.type.bytes == 4 ? owner<std::int32_t>(column, width)
                                           : owner<std::int64_t>(column, width);
        values.attributes.push_back({name, *type, mShape[0], owned});
        return values;
    }

    Positions read()
    {
        const Literal header = readHeader();
        const Literal& type = valueOf(header, "descr");
        for (const Literal& size : valueOf(header, "shape").items) mShape.push_back(sizeOf(size));
        const bool isFortran = valueOf(header, "fortran_order").text == "True";
        if (type.kind == '[') {
            findFields(type);
        } else {
            findColumns(type, isFortran);
        }
        checkSize();
        return values();
    }

private:
    [[noreturn]] void fail(const std::string& what) const { mInput.fail(what); }

    static std::optional<AttributeType> attributeType(const NumberType& type, std::uint64_t width)
    {
        const bool isDouble = type.bytes == 8;
        if (type.kind == 'i' && width == 1 && type.bytes >= 4)
            return isDouble ? AttributeType::kInt64 : AttributeType::kInt32;
        if (type.kind != 'f' || type.bytes < 4) return std::nullopt;
        if (width == 1) return isDouble ? AttributeType::kDouble : AttributeType::kFloat;
        if (width == 3) return isDouble ? AttributeType::kVec3d : AttributeType::kVec3s;
        if (width == 9 && !isDouble) return AttributeType::kMat3s;
        return std::nullopt;
    }

    template <typename To>
    std::shared_ptr<std::vector<To>> numbers(const Column& column, std::uint64_t width) const
    {
        const auto result = std::make_shared<std::vector<To>>(mShape[0] * width);
        for (std::size_t at = 0; at < result->size(); ++at) {
            if (at % kRowsBetweenChecks == 0) mInput.checkCancelled();
            const std::optional<double> value =
                numberAt(mBytes.data() + mBegin + at * mItemBytes, column.type, column.isBigEndian);
            if (!value) fail("has an integer beyond 2^53 in row " + std::to_string(at / width));
            (*result)[at] = static_cast<To>(*value);
        }
        return result;
    }

    template <typename To>
    std::shared_ptr<const void> owner(const Column& column, std::uint64_t width) const
    {
        const auto values = numbers<To>(column, width);
        return {values, values->data()};
    }

    Literal readHeader()
    {
        const std::string magic = "\x93NUMPY";
        if (mBytes.size() < 12 || mBytes.compare(0, magic.size(), magic) != 0) fail("is no .npy file");
        const int version = mBytes[6];
        if (version < 1 || version > 3) fail("is an .npy file of version " + std::to_string(version));
        const unsigned lengthBytes = version == 1 ? 2 : 4;
        const auto length = static_cast<std::size_t>(*numberAt(mBytes.data() + 8, {'u', lengthBytes}, false));
        mBegin = 8 + lengthBytes + length;
        if (mBegin > mBytes.size()) fail("ends inside of its .npy header");
        return LiteralReader(mInput, mBytes.substr(8 + lengthBytes, length)).read();
    }

    const Literal& valueOf(const Literal& dictionary, const std::string& key) const
    {
        for (std::size_t i = 0; i + 1 < dictionary.items.size(); i += 2) {
            if (dictionary.items[i].text == key) return dictionary.items[i + 1];
        }
        fail("has no '" + key + "' in its .npy header");
    }

    std::uint64_t sizeOf(const Literal& literal) const
    {
        const bool isSize = !literal.text.empty() && literal.text.size() <= 18 &&
                            literal.text.find_first_not_of("0123456789") == std::string::npos;
        if (!isSize) fail("has an .npy shape that is no list of sizes");
        return std::stoull(literal.text);
    }

    // "<f4": the order of bytes, a kind and their number. `bytes`: of a value, of any kind.
    Column columnOf(const std::string& descr, std::uint64_t& bytes) const
    {
        if (descr.size() < 3 || descr.size() > 8 ||
            descr.find_first_not_of("0123456789", 2) != std::string::npos)
            fail("has the .npy type '" + descr + "', which is not read");
        bytes = std::stoull(descr.substr(2));
        return {{descr[1], static_cast<unsigned>(bytes)}, descr[0] == '>', 0};
    }

    void checkNumber(const Column& column) const
    {
        if (!isNumberType(column.type)) fail("has an .npy type that is no number of 64 bits or less");
    }

    // Records: ('name', '<f4'), (('title', 'name'), '<f4') or ('name', '<f4', (3,)), packed one behind the
    // other.
    void findFields(const Literal& type)
    {
        std::vector<Field> fields;
        for (const Literal& item : type.items) {
            if (item.items.size() < 2 || item.items[1].kind != '\'')
                fail("has .npy records that are not read");
            const Literal& name = item.items[0];
            Field field;
            field.name = name.kind == '(' && name.items.size() == 2 ? name.items[1].text : name.text;
            field.column = columnOf(item.items[1].text, field.bytes);
            field.column.offset = mItemBytes;
            field.isArray = item.items.size() > 2;
            if (field.isArray) {
                for (const Literal& size : item.items[2].items)
                    field.bytes = product(field.bytes, sizeOf(size));
            }
            mItemBytes += field.bytes;
            fields.push_back(field);
        }
        if (mShape.size() != 1) fail("has .npy records that are no list");
        for (int k = 0; k < 3; ++k) {
            const Field& field = fields[findField(fields, k)];
            if (field.isArray) fail("has several numbers in the field '" + field.name + "'");
            mColumns[k] = field.column;
            checkNumber(field.column);
        }
        mStride = mItemBytes;
    }

    // The number of the field that is coordinate k.
    std::size_t findField(const std::vector<Field>& fields, int k) const
    {
        if (!mInput.options.columns.empty()) {
            mInput.checkColumn(mInput.options.columns[k], fields.size());
            return mInput.options.columns[k];
        }
        const std::string name(1, "xyz"[k]), capital(1, "XYZ"[k]);
        for (const std::string& either : {name, capital}) {
            for (std::size_t i = 0; i < fields.size(); ++i) {
                if (fields[i].name == either) return i;
            }
        }
        fail("has .npy records without a field '" + name + "'");
    }

    void findColumns(const Literal& type, bool isFortran)
    {
        const Column column = columnOf(type.text, mItemBytes);
        checkNumber(column);
        if (mShape.size() != 2) fail("has an .npy array of " + std::to_string(mShape.size()) + " dimensions");
        const std::vector<std::uint32_t>& chosen = mInput.options.columns;
        const std::uint64_t width = mShape[1];
        if (chosen.empty() ? width != 3 : width < 3)
            fail("has an .npy array with " + std::to_string(width) + " columns");
        mStride = isFortran ? mItemBytes : width * mItemBytes;
        for (int k = 0; k < 3; ++k) {
            const std::uint64_t number = chosen.empty() ? static_cast<std::uint64_t>(k) : chosen[k];
            mInput.checkColumn(number, width);
            mColumns[k] = column;
            mColumns[k].offset = number * mItemBytes * (isFortran ? mShape[0] : 1);
        }
    }

    std::uint64_t product(std::uint64_t a, std::uint64_t b) const
    {
        if (b > 0 && a > std::numeric_limits<std::uint64_t>::max() / b)
            fail("has an .npy shape that is too large");
        return a * b;
    }

    void checkSize() const
    {
        std::uint64_t bytes = mItemBytes;
        for (const std::uint64_t size : mShape) bytes = product(bytes, size);
        if (bytes != mBytes.size() - mBegin) {
            fail("has " + std::to_string(mBytes.size() - mBegin) +
                 " bytes of values, and its .npy header says " + std::to_string(bytes));
        }
    }

    Positions values() const
    {
        Positions positions(3 * mShape[0]);
        for (std::uint64_t row = 0; row < mShape[0]; ++row) {
            if (row % kRowsBetweenChecks == 0) mInput.checkCancelled();
            for (int k = 0; k < 3; ++k) {
                const Column& column = mColumns[k];
                const char* const first = mBytes.data() + mBegin + column.offset + row * mStride;
                const std::optional<double> value = numberAt(first, column.type, column.isBigEndian);
                if (!value) fail("has an integer beyond 2^53 in point " + std::to_string(row));
                positions[3 * row + k] = *value;
            }
        }
        return positions;
    }

    const PointInput& mInput;
    const std::string& mBytes;
    std::size_t mBegin = 0; // of the values
    std::vector<std::uint64_t> mShape;
    std::uint64_t mItemBytes = 0, mStride = 0; // of a value or record; from a point to the next
    Column mColumns[3];
};

} // namespace

Positions readNpyPoints(const PointInput& input)
{
    const std::string bytes = input.bytes();
    return NpyArray(input, bytes).read();
}

std::vector<double> readNpyList(const PointInput& input)
{
    const std::string bytes = input.bytes();
    return NpyArray(input, bytes).readList();
}

PointValues readNpzArray(const PointInput& input, const std::string& name)
{
    const FilePieces file(input.path);
    const std::string bytes = zipContent(file, name + ".npy", input.options.progress);
    return NpyArray(input, bytes).readValues(name);
}

Positions readNpzPoints(const PointInput& input)
{
    const FilePieces file(input.path);
    const std::vector<std::string> names = zipNames(file);
    const std::string& wanted = input.options.array;
    std::string found;
    for (const std::string& name : names) {
        const bool isDefault = names.size() == 1 || name == "positions.npy";
        if (name == wanted + ".npy" || (wanted.empty() && isDefault)) found = name;
    }
    if (found.empty()) {
        throw InvalidInput(input.path + ": has " + std::to_string(names.size()) + " arrays, and '" + wanted +
                           "' is none of them");
    }
    const std::string bytes = zipContent(file, found, input.options.progress);
    return NpyArray(input, bytes).read();
}

} // namespace vdb_nns::cli
