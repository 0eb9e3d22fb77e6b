// A stand-in: the numbers of a life cycle's states.
#ifndef STAND_IN_STATE
#define STAND_IN_STATE

#include <cstdint>

namespace lifecycle_msgs::msg
{
struct State
{
  enum : std::uint8_t {
    PRIMARY_STATE_UNKNOWN = 0,
    PRIMARY_STATE_UNCONFIGURED = 1,
    PRIMARY_STATE_INACTIVE = 2,
    PRIMARY_STATE_ACTIVE = 3,
    PRIMARY_STATE_FINALIZED = 4,
    TRANSITION_STATE_CONFIGURING = 10,
    TRANSITION_STATE_CLEANINGUP = 11,
    TRANSITION_STATE_SHUTTINGDOWN = 12,
    TRANSITION_STATE_ACTIVATING = 13,
    TRANSITION_STATE_DEACTIVATING = 14,
    TRANSITION_STATE_ERRORPROCESSING = 15
  };
};
}  // namespace lifecycle_msgs::msg

#endif
