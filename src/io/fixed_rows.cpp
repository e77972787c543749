// Columns are converted one after the other in blocks of rows that stay in a core's cache.
#include "io/fixed_rows.h"

#include "util/memory.h"
#include "vdb_nns/error.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>

namespace vdb_nns {

namespace {

constexpr std::size_t kBlockRows = 1024; // 28 KB of x y z, normal and color
constexpr std::size_t kTaskBlocks = 64;  // about 1 MB a task

// To every kStride-th number. Returns the first row whose value is beyond 2^53, or `count`.
template <bool kIsBigEndian, std::size_t kStride, typename Number, typename Real>
std::size_t convertColumn(const unsigned char* from, std::size_t rowBytes, std::size_t count, Real* out)
{
    for (std::size_t row = 0; row < count; ++row) {
        const Number value = loadNumber<Number>(from + row * rowBytes, kIsBigEndian);
        if (!isExactInDouble(value)) return row;
        out[kStride * row] = static_cast<Real>(value);
    }
    return count;
}

template <typename Real>
void convertRows(const ArrayFile& file, const FixedRows& rows, std::size_t begin, std::size_t end, Real* out)
{
    const unsigned char* const from = file.bytes.data() + rows.begin;
    for (std::size_t block = begin; block < end; block += kBlockRows) {
        const std::size_t count = std::min(kBlockRows, end - block);
        for (std::size_t k = 0; k < 3; ++k) {
            const FixedColumn& column = rows.columns[k];
            const std::size_t offset = block * rows.rowBytes + column.offset;
            const std::size_t read = withNumberType(column.type, [&](auto zero) {
                using Number = decltype(zero);
                const auto convert = rows.isBigEndian ? convertColumn<true, 3, Number, Real>
                                                      : convertColumn<false, 3, Number, Real>;
                return convert(from + offset, rows.rowBytes, count, out + 3 * block + k);
            });
            if (read == count) continue;
            throw InputError(file.path + ": the " + "xyz"[k] + " of point " + std::to_string(block + read) +
                             " at byte " + std::to_string(rows.begin + offset + read * rows.rowBytes) + " " +
                             kIsInexact + "; convert the coordinates to double");
        }
    }
}

template <typename Real>
void readAll(const ArrayFile& file, const FixedRows& rows, std::vector<Real>& out)
{
    resizeOnHugePages(out, 3 * rows.count);
    const std::size_t taskRows = kBlockRows * kTaskBlocks;
    tbb::parallel_for(std::size_t(0), (rows.count + taskRows - 1) / taskRows, [&](std::size_t task) {
        file.cancel.check();
        convertRows(file, rows, task * taskRows, std::min(rows.count, (task + 1) * taskRows), out.data());
    });
}

} // namespace

PositionArray readFixedRows(const ArrayFile& file, const FixedRows& rows)
{
    const bool isFloat = std::all_of(rows.columns.begin(), rows.columns.end(),
                                     [](const FixedColumn& c) { return c.type == NumberType::kFloat; });
    checkPointCount(file, rows.count, !isFloat);
    PositionArray result;
    if (isFloat) {
        readAll(file, rows, result.floats);
    } else {
        readAll(file, rows, result.doubles);
    }
    return result;
}

std::vector<double> readFixedColumn(const ArrayFile& file, const FixedRows& rows, const FixedColumn& column)
{
    checkPointCount(file, rows.count, true, 1);
    std::vector<double> out;
    resizeOnHugePages(out, rows.count);
    const unsigned char* const from = file.bytes.data() + rows.begin + column.offset;
    const std::size_t taskRows = kBlockRows * kTaskBlocks;
    tbb::parallel_for(std::size_t(0), (rows.count + taskRows - 1) / taskRows, [&](std::size_t task) {
        file.cancel.check();
        const std::size_t begin = task * taskRows, count = std::min(taskRows, rows.count - begin);
        withNumberType(column.type, [&](auto zero) {
            using Number = decltype(zero);
            const auto convert = rows.isBigEndian ? convertColumn<true, 1, Number, double>
                                                  : convertColumn<false, 1, Number, double>;
            return convert(from + begin * rows.rowBytes, rows.rowBytes, count, out.data() + begin);
        });
    });
    return out;
}

void checkPointCount(const ArrayFile& file, std::uint64_t count, bool isDouble, std::size_t width)
{
    if (count > kMaxFilePoints) {
        throw InputError(file.path + ": " + std::to_string(count) + " points are more than the " +
                         std::to_string(kMaxFilePoints) + " that fit; split the file");
    }
    checkPointsFit(file.path, count * width * (isDouble ? sizeof(double) : sizeof(float)), file.allowedBytes);
}

} // namespace vdb_nns
