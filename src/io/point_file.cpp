// PointFile: picks the reader of a format, keeps what it read, and describes it. Knows nothing of OpenVDB.
#include "vdb_nns/point_file.h"

#include "io/array_readers.h"
#include "io/byte_source.h"
#include "io/vdb_file.h"
#include "points/particle_source.h"
#include "points/value_check.h"
#include "util/cancel.h"
#include "util/isolate.h"
#include "util/memory.h"
#include "vdb_nns/error.h"

#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_for.h>
#include <oneapi/tbb/parallel_reduce.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <limits>
#include <memory>
#include <mutex>
#include <optional>
#include <utility>

namespace vdb_nns {

struct PointFile::Data {
    std::optional<VdbFile> vdb; // none for array files
    ParticleView view;          // keeps the memory of array files
    PointFileInfo info;         // all but the pass over the positions
    std::uint64_t fileBytes = 0;
    std::uint64_t hostMemoryBytes = 0; // PointFileOptions::hostMemoryBytes
    ArrayChoice choice;
    std::mutex mutex; // of what follows
    std::optional<PointFileInfo> fullInfo;
};

namespace {

// What an array file left in memory: an .npy's bytes as they are, or the positions of a parsed file.
struct ArrayStorage {
    PageBlock bytes;
    PositionArray positions;
    ParticleView view;
};

// One read call each: large enough for the disk, small enough that threads share the copy out of the page
// cache.
constexpr std::size_t kReadBytes = std::size_t(8) << 20;
// Positions decoded at once by a task of info(): 3 arrays of 4 KB on its stack.
constexpr std::size_t kInfoBlock = 512;

PageBlock readBytes(const InputFile& file, const CancelCheck& cancel)
{
    if (static_cast<std::size_t>(file.size()) == 0) return {};
    PageBlock block(static_cast<std::size_t>(file.size()));
    char* const out = static_cast<char*>(block.data());
    const std::size_t pieces = (static_cast<std::size_t>(file.size()) + kReadBytes - 1) / kReadBytes;
    tbb::parallel_for(std::size_t(0), pieces, [&](std::size_t i) {
        cancel.check();
        const std::size_t offset = i * kReadBytes;
        file.readAt(offset, out + offset,
                    std::min(kReadBytes, static_cast<std::size_t>(file.size()) - offset));
    });
    return block;
}

std::string lowerExtension(const std::string& path)
{
    const std::size_t dot = path.rfind('.');
    const std::size_t slash = path.rfind('/');
    if (dot == std::string::npos || (slash != std::string::npos && dot < slash)) return {};
    std::string extension = path.substr(dot + 1);
    for (char& c : extension) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
    return extension;
}

template <typename Real>
ParticleView viewOfNpy(PageBlock& block, const NpyLayout& layout)
{
    char* values = static_cast<char*>(block.data()) + layout.dataOffset;
    if (layout.dataOffset % sizeof(Real) != 0) { // only an old or odd writer's header ends so
        values = static_cast<char*>(block.data());
        std::memmove(values, values + layout.dataOffset, layout.count * 3 * sizeof(Real));
    }
    return ParticleView::fromArray(reinterpret_cast<const Real*>(values), layout.count);
}

// The formats of arrays. An .npy is read by readArray() itself, since it may be used in place.
struct ArrayFormat {
    const char* extension;
    ReadArray (*parse)(const ArrayFile&);
    bool hasColumns;
};
constexpr ArrayFormat kArrayFormats[] = {
    {"npy", nullptr, true},   {"npz", parseNpz, true},  {"ply", parsePly, false},
    {"xyz", parseText, true}, {"txt", parseText, true}, {"csv", parseText, true},
    {"pts", parseText, true}, {"vtk", parseVtk, false}, {"bgeo", parseBgeo, false}};

// Null for other extensions.
const ArrayFormat* arrayFormat(const std::string& extension)
{
    for (const ArrayFormat& format : kArrayFormats) {
        if (extension == format.extension) return &format;
    }
    return nullptr;
}

void checkChoice(const std::string& path, const ArrayFormat* format, const PointFileOptions& options)
{
    const auto refuse = [&](const std::string& what) { throw InvalidInput(path + ": " + what); };
    if (format && !options.grid.empty())
        refuse("a ." + std::string(format->extension) + " file has no grids; leave the grid name '" +
               options.grid + "' out");
    if (!options.array.empty() && (!format || format->parse != parseNpz))
        refuse("only an .npz file has named arrays; leave the array name '" + options.array + "' out");
    const std::vector<std::uint32_t>& columns = options.columns;
    if (columns.empty()) return;
    if (!format || !format->hasColumns)
        refuse("columns are chosen of texts, .npy and .npz files, and this one names its coordinates; leave "
               "them out");
    if (columns.size() != 3 || columns[0] == columns[1] || columns[1] == columns[2] ||
        columns[0] == columns[2])
        refuse("the columns of x, y and z are three different numbers");
}

// Reads the file of `info`, and notes there what was taken and the type of its values.
ParticleView readArray(const InputFile& file, const ArrayFormat& format, const ArrayChoice& choice,
                       std::uint64_t allowedBytes, const CancelCheck& cancel, PointFileInfo& info)
{
    const auto storage = std::make_shared<ArrayStorage>();
    ArrayStorage& data = *storage;
    data.bytes = readBytes(file, cancel);
    const FileBytes bytes(static_cast<const unsigned char*>(data.bytes.data()),
                          static_cast<std::size_t>(file.size()));
    const ArrayFile array{info.path, bytes, choice, allowedBytes - file.size(), cancel};
    NpyLayout layout;
    ReadArray found;
    const bool isInPlace = !format.parse && parseNpy(array, layout, found);
    bool isDouble = layout.isDouble;
    if (isInPlace) {
        data.view = isDouble ? viewOfNpy<double>(data.bytes, layout) : viewOfNpy<float>(data.bytes, layout);
    } else {
        if (format.parse) found = format.parse(array);
        data.positions = std::move(found.positions);
        data.bytes = {};
        const PositionArray& positions = data.positions;
        isDouble = positions.floats.empty();
        data.view = isDouble ? ParticleView::fromArray(positions.doubles.data(), positions.size())
                             : ParticleView::fromArray(positions.floats.data(), positions.size());
    }
    info.codec = isDouble ? "float64" : "float32";
    info.taken = std::move(found.taken);
    info.notes = std::move(found.notes);
    for (NamedValue& property : found.properties)
        info.attributes.push_back({std::move(property.name), std::move(property.type), {}});
    // Copies of the view keep the storage.
    return ParticleView(std::shared_ptr<const ParticleSource>(storage, &data.view.source()));
}

// What one pass over the positions finds.
struct Extent {
    std::uint64_t nonfinite = 0;
    Vec3d min{HUGE_VAL, HUGE_VAL, HUGE_VAL}, max{-HUGE_VAL, -HUGE_VAL, -HUGE_VAL};

    void add(const Vec3d& p)
    {
        for (int k = 0; k < 3; ++k) {
            min[k] = std::min(min[k], p[k]);
            max[k] = std::max(max[k], p[k]);
        }
    }
};

Extent joined(Extent a, const Extent& b)
{
    a.nonfinite += b.nonfinite;
    a.add(b.min);
    a.add(b.max);
    return a;
}

Extent extentOf(const ParticleSource& source, std::size_t begin, std::size_t count, Extent extent)
{
    double x[kInfoBlock], y[kInfoBlock], z[kInfoBlock];
    source.read(begin, count, Vec3d{}, x, y, z);
    const Matrix3& m = source.linear();
    const Vec3d& t = source.translation();
    for (std::size_t i = 0; i < count; ++i) {
        if (!std::isfinite(x[i]) || !std::isfinite(y[i]) || !std::isfinite(z[i])) {
            ++extent.nonfinite;
            continue;
        }
        Vec3d world{x[i], y[i], z[i]};
        if (!source.isArray()) {
            for (int k = 0; k < 3; ++k) world[k] = m[k][0] * x[i] + m[k][1] * y[i] + m[k][2] * z[i] + t[k];
        }
        extent.add(world);
    }
    return extent;
}

void measure(const ParticleSource& source, PointFileInfo& info)
{
    info.points = source.size();
    const std::size_t blocks = (source.size() + kInfoBlock - 1) / kInfoBlock;
    const Extent extent = tbb::parallel_reduce(
        tbb::blocked_range<std::size_t>(0, blocks), Extent{},
        [&](const tbb::blocked_range<std::size_t>& range, Extent sum) {
            for (std::size_t block = range.begin(); block != range.end(); ++block) {
                const std::size_t begin = block * kInfoBlock;
                sum = extentOf(source, begin, std::min(kInfoBlock, source.size() - begin), sum);
            }
            return sum;
        },
        joined);
    info.nonfinite = extent.nonfinite;
    if (info.nonfinite < info.points) info.bbox = std::array<Vec3d, 2>{extent.min, extent.max};
    for (int row = 0; row < 3; ++row) {
        for (int column = 0; column < 3; ++column) info.transform[row][column] = source.linear()[row][column];
        info.transform[row][3] = source.translation()[row];
    }
    info.transform[3] = {0, 0, 0, 1};
}

// `bytes` as PointFileOptions::hostMemoryBytes has it.
std::uint64_t allowedMemory(std::uint64_t bytes)
{
    return bytes ? bytes : availableMemoryBytes();
}

[[noreturn]] void failChanged(const std::string& path, const std::string& how)
{
    throw InputError(path + ": has changed since its points were read: " + how +
                     "; start again once nobody writes it any more");
}

// As far as its size says.
void checkUnchanged(const InputFile& file, std::uint64_t bytes)
{
    if (file.size() == bytes) return;
    failChanged(file.name(),
                "it had " + std::to_string(bytes) + " bytes and has " + std::to_string(file.size()));
}

// parse(ArrayFile) of a whole file.
template <typename Parse>
auto parseValues(const InputFile& file, const ArrayChoice& choice, std::uint64_t allowedBytes,
                 const CancelCheck& cancel, const Parse& parse)
{
    cancel.update(0);
    checkPointsFit(file.name(), file.size(), allowedBytes);
    const PageBlock block = readBytes(file, cancel);
    const FileBytes bytes(static_cast<const unsigned char*>(block.data()),
                          static_cast<std::size_t>(file.size()));
    auto values = parse(ArrayFile{file.name(), bytes, choice, allowedBytes - file.size(), cancel});
    cancel.update(1);
    return values;
}

// The second pass over a .ply found as many vertices as the first one.
void checkVertices(const PointFile::Data& data, std::size_t vertices)
{
    if (vertices == data.view.size()) return;
    failChanged(data.info.path, "it had " + std::to_string(data.view.size()) + " vertices and has " +
                                    std::to_string(vertices));
}

} // namespace

PointFile PointFile::read(const std::string& path, const PointFileOptions& options)
{
    PointFile result;
    result.mData = std::make_shared<Data>();
    Data& data = *result.mData;
    data.info.path = path;
    data.info.format = lowerExtension(path);
    const std::string& format = data.info.format;
    std::error_code error;
    if (std::filesystem::is_directory(path, error))
        throw InputError(path + ": is a folder; give the name of a file in it");
    const ArrayFormat* const array = arrayFormat(format);
    if (format != "vdb" && !array) {
        throw InvalidInput(path + ": unknown extension '" + format +
                           "'; point files are .vdb .npy .npz .ply .vtk .bgeo .xyz .txt .csv .pts");
    }
    checkChoice(path, array, options);
    if (options.tile && array)
        throw InvalidInput(path +
                           ": only a .vdb has leaves, and so tiles that are read alone; read all points");
    const InputFile file(path);
    data.fileBytes = file.size();
    data.hostMemoryBytes = options.hostMemoryBytes;
    data.choice = {options.columns, options.array};
    const std::uint64_t allowedBytes = allowedMemory(options.hostMemoryBytes);
    const auto readFile = [&] {
        const CancelCheck cancel(options.progress, "read");
        if (!array) {
            data.vdb.emplace(file, options.grid, options.tile, allowedBytes, cancel, data.info);
            data.view = data.vdb->view();
        } else {
            cancel.update(0);
            checkPointsFit(path, file.size(), allowedBytes);
            data.view = readArray(file, *array, data.choice, allowedBytes, cancel, data.info);
            cancel.update(1);
        }
    };
    try {
        isolatedIeee(readFile);
    } catch (const std::bad_alloc&) {
        throw CapacityError(path + ": the points of its " +
                                std::to_string(static_cast<std::size_t>(file.size())) +
                                " bytes do not fit the memory: split the file or use a machine with more",
                            static_cast<std::size_t>(file.size()), allowedBytes);
    }
    return result;
}

const ParticleView& PointFile::view() const
{
    return mData->view;
}

const TileNumbers* PointFile::tileNumbers() const
{
    return mData->vdb ? mData->vdb->tileNumbers() : nullptr;
}

const std::string& PointFile::grid() const
{
    return mData->info.grid;
}

const std::string& PointFile::taken() const
{
    return mData->info.taken;
}

const std::vector<std::string>& PointFile::notes() const
{
    return mData->info.notes;
}

const PointFileInfo& PointFile::info() const
{
    Data& data = *mData;
    {
        const std::lock_guard<std::mutex> lock(data.mutex);
        if (data.fullInfo) return *data.fullInfo;
    }
    // Not under the lock: whoever else asks meanwhile measures too, and the first one's result stays.
    PointFileInfo info = data.info;
    isolatedIeee([&] { measure(data.view.source(), info); });
    const std::lock_guard<std::mutex> lock(data.mutex);
    if (!data.fullInfo) data.fullInfo = std::move(info);
    return *data.fullInfo;
}

std::vector<double> PointFile::readScalars(const std::string& name, Progress* progress) const
{
    const Data& data = *mData;
    const std::string& path = data.info.path;
    if (!data.vdb && data.info.format != "ply") {
        throw InvalidInput(path + ": a ." + data.info.format +
                           " file has no named values; a .vdb has attributes and a .ply properties; give "
                           "radii of other points as an .npy file (--radius-file)");
    }
    return isolatedIeee([&] {
        const CancelCheck cancel(progress, "read");
        const InputFile file(path);
        checkUnchanged(file, data.fileBytes);
        const std::uint64_t allowedBytes = allowedMemory(data.hostMemoryBytes);
        if (data.vdb) return data.vdb->readScalars(file, name, allowedBytes, cancel);
        std::vector<double> values =
            parseValues(file, data.choice, allowedBytes, cancel,
                        [&](const ArrayFile& array) { return parsePlyProperty(array, name); });
        checkVertices(data, values.size());
        return values;
    });
}

std::vector<StoredValue> PointFile::listValues(Progress* progress) const
{
    const Data& data = *mData;
    if (!data.vdb && data.info.format != "npz") {
        return listPlyProperties(data.info.attributes);
    }
    return isolatedIeee([&] {
        const CancelCheck cancel(progress, "read");
        const InputFile file(data.info.path);
        checkUnchanged(file, data.fileBytes);
        if (data.vdb) return data.vdb->listValues(file, cancel);
        return parseValues(file, data.choice, allowedMemory(data.hostMemoryBytes), cancel,
                           [&](const ArrayFile& array) { return listNpzArrays(array, data.view.size()); });
    });
}

PointValues PointFile::readValues(const std::vector<StoredValue>& which, Progress* progress) const
{
    const Data& data = *mData;
    for (const StoredValue& value : which) {
        if (!value.isGroup && !value.readAs)
            throw InvalidInput(data.info.path + ": '" + value.name + "' " + value.problem);
    }
    if (which.empty()) return {};
    return isolatedIeee([&] {
        const CancelCheck cancel(progress, "read");
        const InputFile file(data.info.path);
        checkUnchanged(file, data.fileBytes);
        const std::uint64_t allowedBytes = allowedMemory(data.hostMemoryBytes);
        if (data.vdb) {
            PointValues values = data.vdb->readAttributes(file, which, allowedBytes, cancel);
            for (const StoredValue& value : which) {
                if (!value.isGroup) continue;
                const auto members = std::make_shared<std::vector<std::uint8_t>>(
                    data.vdb->readGroups(file, value.name, allowedBytes, cancel));
                values.groups.push_back({value.name, members->size(), {members, members->data()}});
            }
            return values;
        }
        return parseValues(file, data.choice, allowedBytes, cancel, [&](const ArrayFile& array) {
            if (data.info.format == "npz") return readNpzArrays(array, which, data.view.size());
            PointValues values;
            for (const StoredValue& value : which) {
                values.attributes.push_back(readPlyAttribute(array, value));
                checkVertices(data, static_cast<std::size_t>(values.attributes.back().count));
            }
            return values;
        });
    });
}

std::vector<std::uint8_t> PointFile::readGroups(const std::string& list, Progress* progress) const
{
    const Data& data = *mData;
    if (!data.vdb) {
        throw InvalidInput(data.info.path + ": a ." + data.info.format +
                           " file has no point groups; only those of a .vdb file are read");
    }
    return isolatedIeee([&] {
        const CancelCheck cancel(progress, "read");
        const InputFile file(data.info.path);
        checkUnchanged(file, data.fileBytes);
        return data.vdb->readGroups(file, list, allowedMemory(data.hostMemoryBytes), cancel);
    });
}

std::vector<double> readRadiusFile(const std::string& path, std::uint64_t count, Progress* progress)
{
    return isolatedIeee([&] {
        const CancelCheck cancel(progress, "read");
        return parseValues(InputFile(path), {}, availableMemoryBytes(), cancel,
                           [&](const ArrayFile& array) { return parseNpyValues(array, count); });
    });
}

void PointFile::writeVdb(const std::string& path, Span<const std::uint32_t> counts, const std::string& prefix,
                         const OutputOptions& options, Progress* progress) const
{
    const PointAttribute attribute = countAttribute(mData->info.path + ": ", prefix + "count", counts);
    writeVdb(path, PointValues{{attribute}, {}}, options, progress);
}

void PointFile::writeVdb(const std::string& path, const PointValues& values, const OutputOptions& options,
                         Progress* progress) const
{
    if (!mData->vdb) {
        throw InvalidInput(mData->info.path +
                           ": result attributes are written to .vdb files only, and this is a ." +
                           mData->info.format + " file; write lists (.npz) instead");
    }
    isolatedIeee(
        [&] { writeVdbResult(mData->info.path, mData->vdb->chosenGrid(), path, values, options, progress); });
}

} // namespace vdb_nns
