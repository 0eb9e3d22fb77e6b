// A stand-in: no update runs in a thread of its own.
#ifndef STAND_IN_ASYNC
#define STAND_IN_ASYNC

#include <chrono>
#include <functional>
#include <utility>

#include "rclcpp/rclcpp.hpp"

namespace realtime_tools
{
enum class AsyncSchedulingPolicy { SYNCHRONIZED, DETACHED };
struct AsyncFunctionHandlerParams
{
  int thread_priority = 50;
  AsyncSchedulingPolicy scheduling_policy = AsyncSchedulingPolicy::SYNCHRONIZED;
  template <typename Node>
  void initialize(Node, const std::string &)
  {
  }
};
template <typename T>
class AsyncFunctionHandler
{
public:
  template <typename... Given>
  void init(Given &&...)
  {
  }
  void start_thread() {}
  void stop_thread() {}
  void reset_variables() {}
  bool is_running() const { return false; }
  void wait_for_trigger_cycle_to_finish() {}
  void pause_execution() {}
  rclcpp::Time get_current_callback_time() const { return rclcpp::Time(0); }
  std::pair<bool, T> trigger_async_callback(const rclcpp::Time &, const rclcpp::Duration &) { return {false, T()}; }
  std::chrono::nanoseconds get_last_execution_time() const { return {}; }
};
}  // namespace realtime_tools

#endif
