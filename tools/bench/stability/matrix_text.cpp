// The stability matrix as JSON and as a table for people.
#include "bench/stability/matrix.h"
#include "report.h"

#include <nlohmann/json.hpp>

#include <algorithm>

namespace vdb_nns::cli {
namespace {

// At most five characters: 9999, 12k, 3.4M, 10G.
std::string shortCount(std::uint64_t count)
{
    if (count < 10'000) return std::to_string(count);
    double value = static_cast<double>(count) / 1000;
    const char* unit = "k";
    for (const char* next : {"M", "G", "T"}) {
        if (value < 999.5) break;
        value /= 1000;
        unit = next;
    }
    return format(value < 9.95 ? "%.1f%s" : "%.0f%s", value, unit);
}

std::string cellText(const StabilityCell& cell)
{
    const std::string mark = oursHolds(cell) ? "" : "!";
    switch (cell.verdict) {
    case Verdict::kExact:
        return mark + "ok";
    case Verdict::kWrong:
        if (cell.missing + cell.extra + cell.duplicates == 0) return mark + "varies";
        return mark + shortCount(cell.missing) + "+" + shortCount(cell.extra + cell.duplicates);
    case Verdict::kRefused:
        return mark + "refused";
    case Verdict::kCrash:
        return mark + "CRASH";
    case Verdict::kHang:
        return mark + "HANG";
    case Verdict::kMemory:
        return mark + "MEMORY";
    case Verdict::kSkipped:
        break;
    }
    return "-";
}

// A column's head in two lines: what stands before the last '-' of the method's name, and what stands behind it.
struct Head {
    std::string upper, lower;

    explicit Head(const std::string& method)
    {
        const std::size_t dash = method.rfind('-');
        upper = method.substr(0, dash);
        if (dash != std::string::npos) lower = method.substr(dash + 1);
    }
    std::size_t width() const { return std::max(upper.size(), lower.size()); }
};

struct Table {
    std::vector<std::string> methods, cases;
    std::vector<std::vector<std::string>> texts; // by case and method
    std::vector<std::size_t> widths;             // by method
};

Table tableOf(const std::vector<StabilityCell>& cells)
{
    Table table;
    const auto indexIn = [](std::vector<std::string>& names, const std::string& name) {
        const auto found = std::find(names.begin(), names.end(), name);
        if (found != names.end()) return static_cast<std::size_t>(found - names.begin());
        names.push_back(name);
        return names.size() - 1;
    };
    for (const StabilityCell& cell : cells) {
        const std::size_t row = indexIn(table.cases, cell.caseName),
                          column = indexIn(table.methods, cell.method);
        table.texts.resize(table.cases.size());
        table.widths.resize(table.methods.size(), Head(cell.method).width());
        if (table.texts[row].size() <= column) table.texts[row].resize(column + 1);
        table.texts[row][column] = cellText(cell);
        table.widths[column] = std::max(table.widths[column], table.texts[row][column].size());
    }
    return table;
}

std::string padded(const std::string& text, std::size_t width)
{
    return text + std::string(width - std::min(width, text.size()), ' ');
}

std::string trimmed(std::string text)
{
    text.erase(text.find_last_not_of(' ') + 1);
    return text + "\n";
}

std::string tableText(const std::vector<StabilityCell>& cells)
{
    const Table table = tableOf(cells);
    std::size_t nameWidth = 0;
    for (const std::string& name : table.cases) nameWidth = std::max(nameWidth, name.size());
    std::string upper = padded("case", nameWidth), lower = padded("", nameWidth), text;
    for (std::size_t m = 0; m < table.methods.size(); ++m) {
        const Head head(table.methods[m]);
        upper += "  " + padded(head.upper, table.widths[m]);
        lower += "  " + padded(head.lower, table.widths[m]);
    }
    text += trimmed(upper) + trimmed(lower);
    for (std::size_t c = 0; c < table.cases.size(); ++c) {
        std::string row = padded(table.cases[c], nameWidth);
        for (std::size_t m = 0; m < table.texts[c].size(); ++m) {
            row += "  " + padded(table.texts[c][m], table.widths[m]);
        }
        text += trimmed(row);
    }
    return text;
}

// Cells of a case that say the same stand together.
std::string remarks(const std::vector<StabilityCell>& cells)
{
    std::vector<std::pair<std::string, std::string>> lines; // what is said, and of which methods
    std::string text, lastCase;
    const auto flush = [&] {
        for (const auto& [said, methods] : lines) text += lastCase + ": " + methods + ": " + said + "\n";
        lines.clear();
    };
    for (const StabilityCell& cell : cells) {
        if (cell.caseName != lastCase) flush();
        lastCase = cell.caseName;
        const bool isPlain = cell.verdict == Verdict::kExact || cell.verdict == Verdict::kSkipped;
        if ((isPlain && oursHolds(cell)) || cell.message.empty()) continue;
        const auto found =
            std::find_if(lines.begin(), lines.end(), [&](const auto& l) { return l.first == cell.message; });
        if (found == lines.end()) {
            lines.push_back({cell.message, cell.method});
        } else {
            found->second += ", " + cell.method;
        }
    }
    flush();
    return text;
}

std::string failures(const std::vector<StabilityCell>& cells)
{
    std::string text;
    std::uint64_t exact = 0, held = 0;
    for (const StabilityCell& cell : cells) {
        if (!cell.isExact || cell.verdict == Verdict::kSkipped) continue;
        ++exact;
        held += oursHolds(cell);
        if (oursHolds(cell)) continue;
        const char* const due = cell.verdict == Verdict::kRefused && !cell.isClear
                                    ? "it does not say what it has to"
                                : cell.right == RightOutcome::kRefusal ? "a refusal is due"
                                                                       : "an exact answer is due";
        text += "FAULT OF OURS: " + cell.caseName + ": " + cell.method + " is " + verdictName(cell.verdict) +
                "; " + due + "\n";
    }
    if (exact == 0) return text;
    return text + countText(held) + " of " + countText(exact) +
           " cells of exact methods are as they have to be\n";
}

} // namespace

nlohmann::ordered_json stabilityJson(const std::vector<StabilityCell>& cells)
{
    nlohmann::ordered_json array = nlohmann::ordered_json::array();
    for (const StabilityCell& cell : cells) {
        nlohmann::ordered_json object;
        object["case"] = cell.caseName;
        object["group"] = cell.group;
        object["what"] = cell.what;
        object["method"] = cell.method;
        object["verdict"] = verdictName(cell.verdict);
        object["missing"] = cell.missing;
        object["extra"] = cell.extra;
        object["duplicates"] = cell.duplicates;
        object["asymmetric"] = cell.asymmetric ? nlohmann::ordered_json(*cell.asymmetric) : nullptr;
        object["seconds"] = cell.seconds;
        object["peak_rss_bytes"] = cell.peakBytes;
        object["message"] = cell.message;
        object["holds"] = cell.isExact ? nlohmann::ordered_json(oursHolds(cell)) : nullptr;
        array.push_back(object);
    }
    return array;
}

std::string stabilityText(const std::vector<StabilityCell>& cells)
{
    const std::string legend =
        "ok: exact; A+B: A pairs missing and B extra or twice; varies: other pairs from run to run; refused: "
        "an exception that says why;\nCRASH, HANG, MEMORY: the process died, was stopped, ran out of "
        "memory; -: the case is not about such methods; !: a fault of ours\n";
    const std::string said = remarks(cells);
    return tableText(cells) + "\n" + legend + (said.empty() ? "" : "\n" + said) + "\n" + failures(cells);
}

} // namespace vdb_nns::cli
