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

std::string trialText(const StabilityTrial& trial)
{
    const std::string mark = oursHolds(trial) ? "" : "!";
    switch (trial.verdict) {
    case Verdict::kExact:
        return mark + "ok";
    case Verdict::kWrong:
        if (trial.wrongValues > 0) return mark + shortCount(trial.wrongValues) + " off";
        if (trial.missing + trial.extra + trial.duplicates == 0) return mark + "varies";
        return mark + shortCount(trial.missing) + "+" + shortCount(trial.extra + trial.duplicates);
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

Table tableOf(const std::vector<StabilityTrial>& trials)
{
    Table table;
    const auto indexIn = [](std::vector<std::string>& names, const std::string& name) {
        const auto found = std::find(names.begin(), names.end(), name);
        if (found != names.end()) return static_cast<std::size_t>(found - names.begin());
        names.push_back(name);
        return names.size() - 1;
    };
    for (const StabilityTrial& trial : trials) {
        const std::size_t row = indexIn(table.cases, trial.caseName),
                          column = indexIn(table.methods, trial.method);
        table.texts.resize(table.cases.size());
        table.widths.resize(table.methods.size(), Head(trial.method).width());
        if (table.texts[row].size() <= column) table.texts[row].resize(column + 1);
        table.texts[row][column] = trialText(trial);
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

std::string tableText(const std::vector<StabilityTrial>& trials)
{
    const Table table = tableOf(trials);
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

// Trials of a case that say the same stand together.
std::string remarks(const std::vector<StabilityTrial>& trials)
{
    std::vector<std::pair<std::string, std::string>> lines; // what is said, and of which methods
    std::string text, lastCase;
    const auto flush = [&] {
        for (const auto& [said, methods] : lines) text += lastCase + ": " + methods + ": " + said + "\n";
        lines.clear();
    };
    for (const StabilityTrial& trial : trials) {
        if (trial.caseName != lastCase) flush();
        lastCase = trial.caseName;
        const bool isPlain = trial.verdict == Verdict::kExact || trial.verdict == Verdict::kSkipped;
        if ((isPlain && oursHolds(trial)) || trial.message.empty()) continue;
        const auto found =
            std::find_if(lines.begin(), lines.end(), [&](const auto& l) { return l.first == trial.message; });
        if (found == lines.end()) {
            lines.push_back({trial.message, trial.method});
        } else {
            found->second += ", " + trial.method;
        }
    }
    flush();
    return text;
}

std::string failures(const std::vector<StabilityTrial>& trials)
{
    std::string text;
    std::uint64_t exact = 0, held = 0;
    for (const StabilityTrial& trial : trials) {
        if (!trial.isExact || trial.verdict == Verdict::kSkipped) continue;
        ++exact;
        held += oursHolds(trial);
        if (oursHolds(trial)) continue;
        const char* const due = trial.verdict == Verdict::kRefused && !trial.isClear
                                    ? "it does not say what it has to"
                                : trial.right == RightOutcome::kRefusal ? "a refusal is due"
                                                                        : "an exact answer is due";
        text += "FAULT OF OURS: " + trial.caseName + ": " + trial.method + " is " +
                verdictName(trial.verdict) + "; " + due + "\n";
    }
    if (exact == 0) return text;
    return text + countText(held) + " of " + countText(exact) +
           " trials of exact methods are as they have to be\n";
}

} // namespace

nlohmann::ordered_json stabilityJson(const std::vector<StabilityTrial>& trials)
{
    nlohmann::ordered_json array = nlohmann::ordered_json::array();
    for (const StabilityTrial& trial : trials) {
        nlohmann::ordered_json object;
        object["case"] = trial.caseName;
        object["group"] = trial.group;
        object["what"] = trial.what;
        object["method"] = trial.method;
        object["verdict"] = verdictName(trial.verdict);
        object["missing"] = trial.missing;
        object["extra"] = trial.extra;
        object["duplicates"] = trial.duplicates;
        object["wrong_values"] = trial.wrongValues;
        object["asymmetric"] = trial.asymmetric ? nlohmann::ordered_json(*trial.asymmetric) : nullptr;
        object["seconds"] = trial.seconds;
        object["peak_rss_bytes"] = trial.peakBytes;
        object["message"] = trial.message;
        object["holds"] = trial.isExact ? nlohmann::ordered_json(oursHolds(trial)) : nullptr;
        array.push_back(object);
    }
    return array;
}

std::string stabilityText(const std::vector<StabilityTrial>& trials)
{
    const std::string legend =
        "ok: exact; A+B: A pairs missing and B extra or twice; N off: N wrong values of measures; varies: "
        "other pairs or values from run to run;\nrefused: an exception that says why; CRASH, HANG, MEMORY: "
        "the process died, was stopped, ran out of memory;\n-: the case is not about such methods; !: a "
        "fault of ours\n";
    const std::string said = remarks(trials);
    return tableText(trials) + "\n" + legend + (said.empty() ? "" : "\n" + said) + "\n" + failures(trials);
}

} // namespace vdb_nns::cli
