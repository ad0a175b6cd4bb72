/* A stand-in for Force Dimension's dhd: records every force and checks the order of calls. */
#include <math.h>
#include <stdio.h>
#include <string.h>

enum { MOST = 10000 };
#define DEVICE (opens == 1 ? 0 : 3) /* the first is number 0 */

static double forces[MOST][3], torques[MOST][3], latest[3]; /* a torque acts until another is put */
static int count, reads, opens, opened, enabled, failing_after;
static int wrist; /* with motors, a gripper and buttons */
static int serial, ready_after, lacking, present; /* the status at `lacking` is wrong for `ready_after` calls */
static int buttons, gravity, left_handed;
static double mass, gap;
static char faults[400], failing[40], log_[64];

static void need(int truth, const char *words) { if (!truth && !faults[0]) snprintf(faults, sizeof faults, "%s", words); }
static void note(char event) { size_t n = strlen(log_); if (n + 1 < sizeof log_) { log_[n] = event; log_[n + 1] = 0; } }
static int fails(const char *function) { return !strcmp(failing, function) && failing_after-- <= 0; }

void fake_wrist(int is_there) { wrist = is_there; }
const double *fake_torques(void) { return &torques[0][0]; }
void fake_reset(void)
{
    memset(latest, 0, sizeof latest);
    wrist = count = reads = opens = opened = enabled = failing_after = ready_after = 0;
    faults[0] = failing[0] = log_[0] = 0;
    serial = present = gravity = 1;
    left_handed = 0;
    buttons = 5, mass = 0, gap = 0.017;
}
void fake_grip(int pressed, double opening) { buttons = pressed, gap = opening; }
void fake_hand(int is_left) { left_handed = is_left; }
int fake_gravity(void) { return gravity; }
double fake_mass(void) { return mass; }
void fake_unit(int number, int is_present) { serial = number, present = is_present; }
void fake_lack(int status, int calls) { lacking = status, ready_after = calls; }
void fake_fail(const char *function, int after)
{
    snprintf(failing, sizeof failing, "%s", function);
    failing_after = after;
}
const char *fake_faults(void) { return faults; }
const char *fake_log(void) { return log_; }
int fake_count(void) { return count; }
const double *fake_forces(void) { return &forces[0][0]; }

int dhdOpen(void)
{
    note('O');
    if (fails("dhdOpen") || !present) return -1;
    need(!opened, "dhdOpen twice");
    opened = 1, opens++;
    return DEVICE;
}
int dhdOpenSerial(int number) { return number == serial ? dhdOpen() : -1; }
_Bool dhdIsLeftHanded(char device) { need(opened && device == DEVICE, "dhdIsLeftHanded"); return left_handed; }
int dhdSetGravityCompensation(int on, char device)
{
    note('G');
    need(opened && !enabled && device == DEVICE && on <= 1, "dhdSetGravityCompensation");
    if (fails("dhdSetGravityCompensation")) return -1;
    gravity = on;
    return 0;
}
int dhdSetEffectorMass(double kilograms, char device)
{
    note('M');
    need(opened && !enabled && device == DEVICE && kilograms > 0, "dhdSetEffectorMass");
    mass = kilograms;
    return 0;
}
int dhdGetDeviceCount(void) { return present; }
int dhdOpenID(char number) { need(number < present, "dhdOpenID"); return dhdOpen(); }
int dhdGetSerialNumber(unsigned short *number, char device)
{
    need(opened && device == DEVICE, "dhdGetSerialNumber");
    *number = (unsigned short)serial;
    return 0;
}
int dhdGetStatus(int status[16], char device)
{
    int is_ready = ready_after <= 0;
    need(opened && device == DEVICE, "dhdGetStatus");
    status[0] = status[1] = status[2] = 1; /* power, connected, started */
    status[3] = 0;                         /* RESET mode: not calibrated */
    status[10] = gravity;
    if (!is_ready) status[lacking] = !status[lacking], ready_after--;
    return 0;
}
int dhdEnableForce(unsigned char on, char device)
{
    note(on ? 'E' : 'e');
    need(opened && device == DEVICE && on <= 1, "dhdEnableForce");
    if (fails("dhdEnableForce")) return -1;
    enabled = on;
    return 0;
}
int dhdGetPosition(double *x, double *y, double *z, char device)
{
    need(opened && device == DEVICE, "dhdGetPosition");
    if (fails("dhdGetPosition")) return -1;
    *x = 0.001 * reads++;
    *y = -0.01;
    *z = fails("nan") ? NAN : 0.02;
    return reads % 2; /* 1: the time guard answered */
}
int dhdSetForce(double x, double y, double z, char device)
{
    double force[3] = {x, y, z};
    need(opened && device == DEVICE && (enabled || !(x || y || z)), "dhdSetForce without forces on");
    if (fails("dhdSetForce")) return -1;
    if (count < MOST) memcpy(torques[count], latest, sizeof force), memcpy(forces[count++], force, sizeof force);
    return x > 10 ? 2 : 0; /* 2: a motor is at its limit */
}
int dhdSetForceAndTorqueAndGripperForce(
    double x, double y, double z, double u, double v, double w, double gripper, char device)
{
    double force[3] = {x, y, z}, torque[3] = {u, v, w};
    need(opened && device == DEVICE && (enabled || !(x || y || z || u || v || w)), "wrench without forces on");
    need(wrist && gripper == 0, "wrench on a device without motors of the wrist, or a force of the gripper");
    if (fails("dhdSetForceAndTorqueAndGripperForce")) return -1;
    memcpy(latest, torque, sizeof torque);
    if (count < MOST) memcpy(torques[count], torque, sizeof torque), memcpy(forces[count++], force, sizeof force);
    return 0;
}
int dhdGetOrientationFrame(double frame[3][3], char device)
{
    double turned[9] = {0, -1, 0, 1, 0, 0, 0, 0, 1}; /* a quarter turn about z */
    need(opened && wrist && device == DEVICE, "dhdGetOrientationFrame");
    if (fails("dhdGetOrientationFrame")) return -1;
    if (fails("turn nan")) turned[4] = NAN;
    memcpy(frame, turned, sizeof turned);
    return 0;
}
unsigned int dhdGetButtonMask(char device) { need(opened && device == DEVICE, "dhdGetButtonMask"); return wrist ? buttons : 0; }
int dhdGetGripperGap(double *opening, char device)
{
    need(opened && wrist && device == DEVICE, "dhdGetGripperGap");
    *opening = gap;
    return fails("dhdGetGripperGap") ? -1 : 0;
}
_Bool dhdHasWrist(char device) { need(opened && device == DEVICE, "dhdHasWrist"); return wrist; }
_Bool dhdHasGripper(char device) { need(opened && device == DEVICE, "dhdHasGripper"); return wrist; }
int dhdClose(char device)
{
    note('C');
    need(opened && !enabled && device == DEVICE, "dhdClose with forces on");
    opened = 0;
    return 0;
}
const char *dhdErrorGetLastStr(void) { return "no device\nfound"; }
