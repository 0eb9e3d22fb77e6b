// A stand-in for what a controller uses of rclcpp: values, and no middleware.
#ifndef STAND_IN_RCLCPP
#define STAND_IN_RCLCPP

#include <cxxabi.h>

#include <chrono>
#include <cstdint>
#include <cstdio>
#include <map>
#include <memory>
#include <string>
#include <variant>
#include <vector>

namespace rclcpp
{
class Duration
{
public:
  explicit Duration(std::chrono::nanoseconds length) : length_(length) {}
  double seconds() const { return std::chrono::duration<double>(length_).count(); }

private:
  std::chrono::nanoseconds length_;
};

enum ClockType { UNINITIALIZED, KNOWN };

class Time
{
public:
  explicit Time(std::int64_t nanoseconds = 0) : nanoseconds_(nanoseconds) {}
  double seconds() const { return 1e-9 * static_cast<double>(nanoseconds_); }
  int get_clock_type() const { return KNOWN; }
  Duration operator-(const Time & other) const
  {
    return Duration(std::chrono::nanoseconds(nanoseconds_ - other.nanoseconds_));
  }

private:
  std::int64_t nanoseconds_;
};

struct Logger
{
  std::string name;
};
inline Logger get_logger(const std::string & name) { return {name}; }
inline bool ok() { return true; }
struct Clock
{
};

struct NodeOptions
{
  NodeOptions & enable_logger_service(bool) { return *this; }
};

class Parameter
{
public:
  using Value = std::variant<bool, int, double, std::string, std::vector<std::string>, std::vector<double>>;
  explicit Parameter(Value value = 0) : value_(std::move(value)) {}
  template <typename T>
  T get_value() const
  {
    return std::get<T>(value_);
  }
  bool as_bool() const { return get_value<bool>(); }
  long as_int() const { return get_value<int>(); }
  std::string as_string() const { return get_value<std::string>(); }
  std::vector<std::string> as_string_array() const { return get_value<std::vector<std::string>>(); }
  std::vector<double> as_double_array() const { return get_value<std::vector<double>>(); }

private:
  Value value_;
};
}  // namespace rclcpp

#define RCL_CLOCK_UNINITIALIZED rclcpp::UNINITIALIZED

// What is said goes to the standard error, with its level.
#define STAND_IN_SAY(level, logger, ...) \
  (std::fprintf(stderr, level " %s: ", (logger).name.c_str()), std::fprintf(stderr, __VA_ARGS__), std::fputc('\n', stderr))
#define RCLCPP_ERROR(logger, ...) STAND_IN_SAY("ERROR", logger, __VA_ARGS__)
#define RCLCPP_WARN(logger, ...) STAND_IN_SAY("WARN", logger, __VA_ARGS__)
#define RCLCPP_INFO(logger, ...) STAND_IN_SAY("INFO", logger, __VA_ARGS__)
#define RCLCPP_DEBUG(logger, ...) (void)(logger)
#define RCLCPP_WARN_EXPRESSION(logger, expression, ...) \
  do {                                                  \
    if (expression) RCLCPP_WARN(logger, __VA_ARGS__);   \
  } while (0)
#define RCLCPP_INFO_EXPRESSION RCLCPP_WARN_EXPRESSION
#define RCLCPP_WARN_THROTTLE(logger, clock, ms, ...) RCLCPP_WARN(logger, __VA_ARGS__)

#endif
