#include "failure.h"

#include "exit_codes.h"
#include "thread_failure.h"
#include "vdb_nns/error.h"

#include <new>

namespace vdb_nns::cli {
namespace {

// Names what was at work, if the message does not.
std::string about(const Session& session, const std::string& message)
{
    const bool isOther = !session.otherPath.empty() && message.rfind(session.otherPath + ":", 0) == 0;
    const bool named = session.path.empty() || isOther || message.find(session.path) != std::string::npos;
    const std::string grid = session.grid.empty() ? "" : " (grid " + session.grid + ")";
    return (named ? "" : session.path + grid + ": ") + message;
}

} // namespace

Failure failureOf(const Session& session)
{
    const std::string& flags = session.memoryFlags;
    try {
        throw;
    } catch (const Cancelled&) {
        throw;
    } catch (const CheckFailed& e) {
        return {kCheckFailed, about(session, e.what())};
    } catch (const OutputExists& e) {
        return {kBadUsage, e.what()};
    } catch (const OutputError& e) {
        return {kNotWritten, e.what()};
    } catch (const InvalidInput& e) {
        return {kBadUsage, about(session, e.what())};
    } catch (const InputError& e) {
        return {kBadInput, about(session, e.what())};
    } catch (const CapacityError& e) {
        return {kNoRoom, about(session, e.what() + (flags.empty() ? "" : "; the flags are " + flags))};
    } catch (const std::bad_alloc&) {
        const std::string advice =
            flags.empty() ? "use a machine with more memory" : "the flags are " + flags;
        return {kNoRoom, about(session, "the memory is used up; " + advice)};
    } catch (const DeviceError& e) {
        return {kNoDevice, about(session, e.what())};
    } catch (const std::exception& e) {
        if (isThreadFailure(e)) return {kNoRoom, threadAdvice(e)};
        return {kUnexpected,
                about(session, std::string("a fault of vdb_nns itself, please report it: ") + e.what())};
    }
}

} // namespace vdb_nns::cli
