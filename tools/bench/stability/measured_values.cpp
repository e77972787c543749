#include "bench/stability/measured_values.h"

#include "bench/stability/measure_task.h"
#include "bench/stability/value_ranges.h"
#include "measure_options.h"
#include "numbers.h"
#include "report.h"
#include "vdb_nns/error.h"
#include "verify/measure_check.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstring>

namespace vdb_nns::cli {
namespace {

SearchTerms termsOf(const CaseParticles& particles)
{
    const SetSearch search = searchOf(particles);
    SearchTerms terms;
    terms.queries = search.queries;
    terms.candidates = search.candidates;
    terms.queryTranslation = terms.candidateTranslation = particles.translation;
    terms.radius = search.radius;
    terms.nearest = search.nearest;
    return terms;
}

void addWrong(TrialCheck& check, std::uint64_t count, const std::string& what, const MeasuredPass& pass)
{
    if (count == 0) return;
    check.wrongValues += count;
    if (check.message.empty())
        check.message = what + std::string(" (") + kernelName(pass.options.kernel) + ")";
}

std::string sentenceOf(const ValueFinding& finding)
{
    const ValueExample& example = finding.examples.front();
    const std::string head = format("%s of particle %llu, number %zu, ", finding.name.c_str(),
                                    static_cast<unsigned long long>(example.query), example.component);
    if (!example.what.empty()) return head + format("%g, ", example.value) + example.what;
    return head +
           format("is %.9g, expected %.9g within %.1e", example.value, example.expected, example.bound);
}

std::uint64_t skippedOf(const PointAttribute& attribute)
{
    const std::size_t width = attributeWidth(attribute.type);
    const bool isDouble = attribute.type == AttributeType::kDouble || attribute.type == AttributeType::kVec3d;
    std::uint64_t skipped = 0;
    if (attribute.type == AttributeType::kInt32) return 0;
    for (std::size_t i = 0; i < attribute.count; ++i) {
        bool isFinite = true;
        for (std::size_t k = width * i; k < width * (i + 1); ++k) {
            isFinite &= isDouble ? std::isfinite(static_cast<const double*>(attribute.values.get())[k])
                                 : std::isfinite(static_cast<const float*>(attribute.values.get())[k]);
        }
        skipped += !isFinite;
    }
    return skipped;
}

void checkSkipped(const MeasuredPass& pass, TrialCheck& check)
{
    for (const PointAttribute& attribute : pass.options.attributes) {
        std::uint64_t said = 0;
        for (const Measured::Skipped& skipped : pass.made.skipped) {
            if (skipped.attribute == attribute.name) said += skipped.values;
        }
        addWrong(check, said != skippedOf(attribute),
                 "values skipped of '" + attribute.name + "' are not counted", pass);
    }
}

// By the check of `verify`, and then, as it has found every value to be there, by the ranges.
void checkPass(const CaseParticles& particles, const SearchTerms& terms, const MeasuredPass& pass,
               TrialCheck& check)
{
    const MeasureClaims claims = {"bench", pass.names, pass.options, pass.made.values, {}};
    const MeasureReport report = verifyMeasures(terms, claims);
    for (const ValueFinding& finding : report.findings) {
        if (finding.count > 0) addWrong(check, finding.count, sentenceOf(finding), pass);
    }
    const RangeFaults faults =
        findRangeFaults(searchOf(particles), pass.options, pass.made, particles.measures->mayPassRange);
    addWrong(check, faults.count, faults.first, pass);
    checkSkipped(pass, check);
}

} // namespace

TrialCheck checkMeasured(const CaseParticles& particles, const std::vector<MeasuredPass>& passes)
{
    TrialCheck check;
    const SearchTerms terms = termsOf(particles);
    for (const MeasuredPass& pass : passes) {
        try {
            checkPass(particles, terms, pass, check);
        } catch (const Error& e) { // values that are not there, or too few
            addWrong(check, 1, e.what(), pass);
        }
    }
    check.pairSum = hashOfMeasured(passes);
    return check;
}

std::uint64_t hashOfMeasured(const std::vector<MeasuredPass>& passes)
{
    std::uint64_t hash = 0;
    const auto add = [&hash](const void* bytes, std::size_t count) {
        for (std::size_t at = 0; at < count; at += sizeof(std::uint64_t)) {
            std::uint64_t part = 0;
            std::memcpy(&part, static_cast<const char*>(bytes) + at, std::min(sizeof part, count - at));
            hash = mix64(hash ^ part) + 1;
        }
    };
    for (const MeasuredPass& pass : passes) {
        for (const PointAttribute& attribute : pass.made.values.attributes)
            add(attribute.values.get(), attribute.count * attributeBytes(attribute.type));
        for (const PointGroup& group : pass.made.values.groups) add(group.members.get(), group.count);
    }
    return hash;
}

} // namespace vdb_nns::cli
