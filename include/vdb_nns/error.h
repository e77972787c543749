// The exceptions of the library, one for each kind of fault. The library never prints and never exits.
#pragma once

#include <cstdint>
#include <stdexcept>
#include <string>

namespace vdb_nns {

/// Base of everything that the library throws on purpose. `what()` names the value that was out of
/// bounds, the limit and the next step.
class Error : public std::runtime_error {
public:
    using std::runtime_error::runtime_error;
};

/// The caller's mistake: a radius that is not a positive finite number, contradictory options.
class InvalidInput : public Error {
public:
    using Error::Error;
};

/// The particles cannot be read or are not supported: a missing or damaged file, a frustum transform,
/// coordinates out of range.
class InputError : public Error {
public:
    using Error::Error;
};

/// Something does not fit the memory that it may use.
class CapacityError : public Error {
public:
    CapacityError(const std::string& message, std::uint64_t neededBytes, std::uint64_t allowedBytes)
        : Error(message), mNeededBytes(neededBytes), mAllowedBytes(allowedBytes)
    {
    }

    /// Bytes that the result needs: exact, or an estimate if the message says "about".
    std::uint64_t neededBytes() const { return mNeededBytes; }
    /// Bytes that the options or the machine allow.
    std::uint64_t allowedBytes() const { return mAllowedBytes; }

private:
    std::uint64_t mNeededBytes, mAllowedBytes;
};

/// An output file exists and the caller did not ask to overwrite it, or it is not a regular file.
class OutputExists : public InvalidInput {
public:
    using InvalidInput::InvalidInput;
};

/// An output file cannot be written: disk full, no permission, size limit.
class OutputError : public Error {
public:
    using Error::Error;
};

/// The device asked for is not there, or it failed.
class DeviceError : public Error {
public:
    using Error::Error;
};

/// A `Progress` asked to stop.
class Cancelled : public Error {
public:
    using Error::Error;
};

} // namespace vdb_nns
