// Cells are projected along one axis; `Frame` maps the two others to the page, whose y points down.
// Blocks are aligned cubes, so their squares on the page are the same, nested or apart: blocks behind each other share a
// square, a stripe each, and smaller squares stand inset in larger ones. Every block that is drawn can be seen.
#include "plan_svg.h"

#include <nlohmann/json.hpp>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <tuple>
#include <utility>

namespace vdb_nns::cli {
namespace {

constexpr std::size_t kMostBlocks = 20000; // at 80 bytes each; a page has no room for more
constexpr std::size_t kShadowBins = 192;   // along the longer side: under 400 KB whatever the scene
constexpr double kMargin = 24, kTop = 84, kSide = 680, kLegendWidth = 300, kLegendLine = 22;
constexpr double kFaintest = 0.25; // strength of the colour of a block without work; 1 of the one with most
constexpr double kInsetShare = 0.06, kMostInset = 3, kLeastPixels = 0.3,
                 kLeastOutlined = 5; // pixels but the share
constexpr const char* kCpuColor = "#d55e00";
constexpr const char* kDeviceColors[] = {"#0072b2", "#009e73", "#cc79a7", "#56b4e9", "#6a3d9a", "#b8a000",
                                         "#1b5e20", "#880e4f", "#00838f", "#3949ab", "#7cb342", "#8e6c8a",
                                         "#4e6e81", "#a0527f", "#2e8b8b", "#5d4037"};

const char* colorOf(int executor)
{
    return executor == Block::kOnCpu
               ? kCpuColor
               : kDeviceColors[static_cast<std::size_t>(executor) % std::size(kDeviceColors)];
}

// Text between tags: valid UTF-8 without markup and control characters. JSON's replacement mends what is not UTF-8.
std::string escape(const std::string& text)
{
    using Json = nlohmann::json;
    const std::string valid =
        Json::parse(Json(text).dump(-1, ' ', false, Json::error_handler_t::replace)).get<std::string>();
    std::string out;
    for (const char c : valid) {
        switch (c) {
        case '&':
            out += "&amp;";
            break;
        case '<':
            out += "&lt;";
            break;
        case '>':
            out += "&gt;";
            break;
        default:
            out += static_cast<unsigned char>(c) < 0x20 ? '?' : c;
        }
    }
    return out;
}

std::string textAt(double x, double y, const std::string& text, const char* attributes = "")
{
    return format("<text x=\"%.1f\" y=\"%.1f\"%s>", x, y, attributes) + escape(text) + "</text>\n";
}

// A colour on white.
std::string tint(const char* color, double strength)
{
    const unsigned long rgb = std::strtoul(color + 1, nullptr, 16);
    std::string out = "#";
    for (const int shift : {16, 8, 0}) {
        const auto channel = static_cast<double>(rgb >> shift & 0xff);
        out += format("%02x", static_cast<unsigned>(std::lround(255 + (channel - 255) * strength)));
    }
    return out;
}

double strengthOf(double share)
{
    return kFaintest + (1 - kFaintest) * std::sqrt(share);
}

// Where cells stand on the page.
struct Frame {
    std::size_t across = 0, up = 1, along = 2; // axes: of the page, and the one that is looked along
    double low[2] = {0, 0}, end[2] = {1, 1};   // cells, of `across` and `up`
    double pixelsPerCell = 1;

    explicit Frame(const Plan& plan)
    {
        const auto extent = [&](std::size_t k) { return std::int64_t(plan.endCell[k]) - plan.lowCell[k]; };
        for (std::size_t k = 0; k < 3; ++k) {
            if (extent(k) < extent(along)) along = k;
        }
        across = along == 0 ? 1 : 0;
        up = along == 2 ? 1 : 2;
        low[0] = plan.lowCell[across], low[1] = plan.lowCell[up];
        end[0] = std::max(low[0] + 1, double(plan.endCell[across]));
        end[1] = std::max(low[1] + 1, double(plan.endCell[up]));
        pixelsPerCell = kSide / std::max(end[0] - low[0], end[1] - low[1]);
    }

    double width() const { return (end[0] - low[0]) * pixelsPerCell; }
    double height() const { return (end[1] - low[1]) * pixelsPerCell; }
    double left(double cell) const { return kMargin + (cell - low[0]) * pixelsPerCell; }
    double top(double cell) const { return kTop + (end[1] - cell) * pixelsPerCell; }
};

// Where there are particles: occupied leaves in bins, a path of runs for each row of bins.
std::string shadow(const SparseGrid& grid, const Frame& frame)
{
    constexpr double kLeafCells = 8;
    const double longer = std::max(frame.end[0] - frame.low[0], frame.end[1] - frame.low[1]);
    const double binCells = kLeafCells * std::max(1.0, std::ceil(longer / kLeafCells / double(kShadowBins)));
    const auto bins = [&](int k) {
        return static_cast<std::size_t>(std::ceil((frame.end[k] - frame.low[k]) / binCells));
    };
    const std::size_t columns = bins(0), rows = bins(1);
    std::vector<bool> isOccupied(columns * rows);
    for (std::uint64_t l = 0; l < grid.leafCount(); ++l) {
        const Vec3i origin = grid.leaf(l).origin;
        const auto column = static_cast<std::size_t>((origin[frame.across] - frame.low[0]) / binCells);
        const auto row = static_cast<std::size_t>((origin[frame.up] - frame.low[1]) / binCells);
        isOccupied[row * columns + column] = true;
    }
    const double pixels = binCells * frame.pixelsPerCell;
    std::string path;
    for (std::size_t row = 0; row < rows; ++row) {
        for (std::size_t begin = 0; begin < columns;) {
            std::size_t end = begin;
            while (end < columns && isOccupied[row * columns + end]) ++end;
            if (end > begin) {
                const double x = kMargin + static_cast<double>(begin) * pixels;
                const double y = kTop + frame.height() - static_cast<double>(row + 1) * pixels;
                path += format("M%.1f %.1fh%.1fv%.1fh-%.1fz", x, y, static_cast<double>(end - begin) * pixels,
                               pixels, static_cast<double>(end - begin) * pixels);
            }
            begin = std::max(end, begin + 1);
        }
    }
    return "<path fill-opacity=\".16\" d=\"" + path + "\"/>\n";
}

bool leavesBoundary(const Block& block)
{
    return block.preferred != Block::kOnCpu && !block.withHalo && block.halo.boundaryLeaves > 0;
}

// Blocks with the most work, and what is left out.
struct Selection {
    std::vector<const Block*> blocks;
    std::size_t leftOut = 0;
    double mostTests = 0, leftOutTests = 0;

    explicit Selection(const std::vector<Block>& all)
    {
        for (const Block& block : all) blocks.push_back(&block);
        std::stable_sort(blocks.begin(), blocks.end(), [](const Block* a, const Block* b) {
            return a->work.candidateTests > b->work.candidateTests;
        });
        if (!blocks.empty()) mostTests = static_cast<double>(blocks[0]->work.candidateTests);
        for (std::size_t b = kMostBlocks; b < blocks.size(); ++b) {
            ++leftOut;
            leftOutTests += static_cast<double>(blocks[b]->work.candidateTests);
        }
        if (leftOut > 0) blocks.resize(kMostBlocks);
    }
};

// What a block covers of the page, before it is shared with others.
struct Square {
    double left, top, width, height;

    Square(const Block& block, const Frame& frame)
    {
        double low[2] = {frame.low[0], frame.low[1]}, end[2] = {frame.end[0], frame.end[1]};
        if (block.log2Cells != WorkloadNode::kRoot) {
            const double edge = std::ldexp(1, block.log2Cells);
            const double origin[2] = {double(block.origin[frame.across]), double(block.origin[frame.up])};
            for (std::size_t k = 0; k < 2; ++k) {
                low[k] = std::max(low[k], origin[k]);
                end[k] = std::min(end[k], origin[k] + edge);
            }
        }
        left = frame.left(low[0]);
        top = frame.top(end[1]);
        width = (end[0] - low[0]) * frame.pixelsPerCell;
        height = (end[1] - low[1]) * frame.pixelsPerCell;
        const double inset = std::min(kMostInset, kInsetShare * std::min(width, height));
        left += inset, top += inset, width -= 2 * inset, height -= 2 * inset;
    }
};

// Stripes of blocks with the same square.
std::string stripes(const Block* const* begin, const Block* const* end, const Frame& frame, double mostTests)
{
    const Square square(**begin, frame);
    const double height = square.height / static_cast<double>(end - begin);
    std::string out;
    double top = square.top;
    for (const Block* const* b = begin; b < end; ++b, top += height) {
        const Block& block = **b;
        const double share = mostTests > 0 ? static_cast<double>(block.work.candidateTests) / mostTests : 0;
        std::string name =
            block.preferred == Block::kOnCpu ? std::string("c") : "d" + std::to_string(block.preferred);
        if (leavesBoundary(block))
            name += " b";
        else if (std::min(square.width, height) >= kLeastOutlined)
            name += " e";
        out +=
            format("<rect x=\"%.1f\" y=\"%.1f\" width=\"%.1f\" height=\"%.1f\" fill=\"%s\" class=\"%s\"/>\n",
                   square.left, top, std::max(kLeastPixels, square.width), std::max(kLeastPixels, height),
                   tint(colorOf(block.preferred), strengthOf(share)).c_str(), name.c_str());
    }
    return out;
}

std::string drawBlocks(std::vector<const Block*> blocks, const Frame& frame, double mostTests)
{
    const auto square = [&](const Block* b) {
        return std::make_tuple(-b->log2Cells, b->origin[frame.up], b->origin[frame.across]);
    };
    std::stable_sort(blocks.begin(), blocks.end(), [&](const Block* a, const Block* b) {
        return std::make_pair(square(a), a->origin[frame.along]) <
               std::make_pair(square(b), b->origin[frame.along]);
    });
    std::string out = "<g>\n";
    for (std::size_t begin = 0; begin < blocks.size();) {
        std::size_t end = begin + 1;
        while (end < blocks.size() && square(blocks[end]) == square(blocks[begin])) ++end;
        out += stripes(blocks.data() + begin, blocks.data() + end, frame, mostTests);
        begin = end;
    }
    return out + "</g>\n";
}

// A round length that is a fifth to a half of the picture's width.
double roundLength(double width)
{
    const double power = std::pow(10, std::floor(std::log10(width / 2)));
    for (const double digit : {5.0, 2.0}) {
        if (digit * power <= width / 2) return digit * power;
    }
    return power;
}

std::string swatch(double x, double y, const char* color, const char* attributes = "")
{
    return format("<rect x=\"%.1f\" y=\"%.1f\" width=\"14\" height=\"14\" fill=\"%s\"%s/>\n", x, y - 12,
                  color, attributes);
}

std::string legend(const SparseGrid& grid, const Plan& plan, const Selection& selection, const Frame& frame,
                   double& y)
{
    const double x = kMargin * 2 + kSide, textX = x + 22;
    const Schedule& schedule = plan.schedule;
    std::string out;
    const auto next = [&] { return y += kLegendLine; };
    out += textAt(x, y, "Who runs a block", " class=\"h\"");
    std::uint64_t cpuBlocks = schedule.blocks.size();
    for (std::size_t d = 0; d < schedule.devices.size(); ++d) {
        const auto executor = static_cast<int>(d);
        out += swatch(x, next(), colorOf(executor));
        out += textAt(textX, y,
                      executorName(plan.devices, executor) + ": " + countText(schedule.devices[d].blocks) +
                          " blocks, " + countText(schedule.devices[d].particles) + " particles");
        cpuBlocks -= schedule.devices[d].blocks;
    }
    out += swatch(x, next(), kCpuColor);
    out += textAt(textX, y,
                  "cpu: " + countText(cpuBlocks) + " blocks, " + countText(schedule.cpuParticles) +
                      " particles");
    if (schedule.boundaryLeaves > 0) {
        out += swatch(x, next(), "#fff", " class=\"b\"");
        out += textAt(textX, y, countText(schedule.boundaryLeaves) + " boundary leaves left to the CPU");
    }
    next();
    out += textAt(x, next(), "Work of a block (candidate tests)", " class=\"h\"");
    for (const double share : {0.0, 0.25, 1.0}) {
        out += swatch(x, next(), tint("#333333", strengthOf(share)).c_str());
        out += textAt(textX, y, format("%.3g", share * selection.mostTests));
    }
    next();
    out += textAt(x, next(), "Scale", " class=\"h\"");
    const double cells = std::max(frame.end[0] - frame.low[0], frame.end[1] - frame.low[1]);
    const double length = roundLength(cells * grid.cellSize() / 2);
    const double pixels = length / grid.cellSize() * frame.pixelsPerCell;
    next();
    out += format("<path d=\"M%.1f %.1fv6h%.1fv-6\" fill=\"none\" stroke=\"#222\"/>\n", x, y - 10, pixels);
    out += textAt(x, next(), format("%g world units = %.4g cells", length, length / grid.cellSize()));
    const char* const names = "xyz";
    out += textAt(x, next(),
                  format("%c to the right, %c up, seen along %c", names[frame.across], names[frame.up],
                         names[frame.along]));
    out += swatch(x, next(), "#000", " fill-opacity=\".16\"");
    out += textAt(textX, y, "darker: leaves with particles");
    out += textAt(x, next(), "Stripes of a square: blocks behind each other.");
    out += textAt(x, next(), "Squares inside others: smaller blocks there.");
    if (selection.leftOut > 0) {
        next();
        const double tests = std::max(1.0, static_cast<double>(plan.total.candidateTests));
        out += textAt(x, next(), format("Not drawn: %zu blocks of the least work", selection.leftOut));
        out += textAt(x, next(),
                      format("(%.2g %% of all tests); there is room for %zu.",
                             100 * selection.leftOutTests / tests, kMostBlocks));
    }
    return out;
}

std::string subtitle(const Plan& plan)
{
    const Schedule& schedule = plan.schedule;
    std::string text = countText(schedule.blocks.size()) + " blocks, needs " +
                       bytesText(plan.everything.total()) + " at once; ";
    if (plan.devices.empty()) return text + "no device";
    text += countText(plan.devices.size()) + " x " + plan.devices[0].name + " with " +
            bytesText(plan.devices[0].memoryBytes);
    if (!schedule.inCore) text += std::string(", boundary: ") + boundaryModeName(schedule.boundary);
    return text + format("; predicted %.4g s", schedule.predictedSeconds);
}

} // namespace

std::string planSvg(const SparseGrid& grid, const Plan& plan, const std::string& scene)
{
    const Frame frame(plan);
    const Selection selection(plan.schedule.blocks);
    std::string body = drawBlocks(selection.blocks, frame, selection.mostTests);
    body += shadow(grid, frame);
    body +=
        format("<rect x=\"%.1f\" y=\"%.1f\" width=\"%.1f\" height=\"%.1f\" fill=\"none\" stroke=\"#888\"/>\n",
               kMargin, kTop, frame.width(), frame.height());
    double legendEnd = kTop + 12;
    body += legend(grid, plan, selection, frame, legendEnd);
    const double width = kMargin * 3 + kSide + kLegendWidth;
    const double height = std::max(legendEnd, kTop + frame.height()) + kMargin;
    std::string svg = format("<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"%.0f\" height=\"%.0f\" "
                             "viewBox=\"0 0 %.0f %.0f\" font-family=\"sans-serif\" font-size=\"13\">\n",
                             width, height, width, height);
    svg += "<style>.e{stroke:#fff;stroke-width:.5}.b{stroke:#111;stroke-width:1.2;stroke-dasharray:3 "
           "2}.h{font-weight:bold}</style>\n";
    svg += "<rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n";
    svg += textAt(kMargin, 34,
                  scene + ": " + countText(plan.total.particles) + " particles, radius " +
                      shortest(grid.radius()),
                  " class=\"h\" font-size=\"17\"");
    svg += textAt(kMargin, 60, subtitle(plan));
    return svg + body + "</svg>\n";
}

} // namespace vdb_nns::cli
