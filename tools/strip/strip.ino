/* Board-dependent part of the firmware for Arduino: reading of the pins.
 *
 * The strip has a drive line with two ends and a sense line; R0 (10 kOhm) connects the sense line with PIN_LOAD.
 * Readings as in the manufacturer's integration guide: position with both ends driven and the sense line open, force with
 * one end driven, the other read, and the sense line loaded by R0.
 *
 * At its start the board switches on the driver of the palm's vibration motor, a DRV2605L on its I2C pins; a board without
 * a driver works as well. The motor runs at a fixed frequency and level as long as the board has its supply.
 *
 * 12-bit inputs are read once. AVR boards have 10 bits: the sum of four readings is used as 12 bits.
 */
#include <Wire.h>

#include "strip.h"

const int PIN_END1 = A0, PIN_SENSE = A1, PIN_END2 = A2, PIN_LOAD = A3;
const int PINS[] = {PIN_END1, PIN_SENSE, PIN_END2, PIN_LOAD};
const unsigned SETTLE_US = 20;
#ifdef __AVR__
const int READS = 4; /* of 10 bits */
#else
const int READS = 1; /* of 12 bits */
#endif

const int PIN_PALM2 = 4;                          /* connected to ground on palm 2's board */
const uint8_t DRIVER = 0x5A;                      /* I2C address */
const uint8_t PERIOD_PALM1 = 43, PERIOD_PALM2 = 44; /* in 98.46 us: 236.2 and 230.8 Hz, 5 Hz apart */
const uint8_t CLAMP = 104;                        /* full drive of about 2 V RMS; measure it */
const uint8_t LEVEL = 100;                        /* of 255: share of full drive; set it by an accelerometer */

static struct strip strip;

static void drive(int pin, int level)
{
    pinMode(pin, OUTPUT);
    digitalWrite(pin, level);
}

static void discharge()
{
    for (int pin : PINS)
        drive(pin, LOW);
    delayMicroseconds(SETTLE_US);
}

static uint16_t read12(int pin)
{
    uint16_t sum = 0;
    for (int i = 0; i < READS; i++)
        sum += analogRead(pin);
    return sum;
}

static uint16_t position_sum()
{
    discharge();
    drive(PIN_END1, LOW); /* the end at the hinge: counts increase away from it */
    drive(PIN_END2, HIGH);
    pinMode(PIN_LOAD, INPUT);
    pinMode(PIN_SENSE, INPUT);
    delayMicroseconds(SETTLE_US);
    uint16_t sum = 0;
    for (int i = 0; i < STRIP_POSITION_READS; i++)
        sum += read12(PIN_SENSE);
    return sum;
}

static void force(struct strip_readings *readings)
{
    discharge();
    drive(PIN_END1, HIGH);
    drive(PIN_LOAD, LOW);
    pinMode(PIN_END2, INPUT);
    pinMode(PIN_SENSE, INPUT);
    delayMicroseconds(SETTLE_US);
    readings->drive = read12(PIN_END2);
    readings->sense = read12(PIN_SENSE);
}

static void set(uint8_t address, uint8_t value)
{
    Wire.beginTransmission(DRIVER);
    Wire.write(address);
    Wire.write(value);
    Wire.endTransmission();
}

static void vibrate()
{
    pinMode(PIN_PALM2, INPUT_PULLUP);
    Wire.begin();
    set(0x01, 0x05); /* out of standby; real-time playback */
    set(0x1A, 0xB6); /* linear resonant actuator */
    set(0x1D, 0xA9); /* open loop, unsigned level */
    set(0x17, CLAMP);
    set(0x20, digitalRead(PIN_PALM2) == LOW ? PERIOD_PALM2 : PERIOD_PALM1);
    set(0x02, LEVEL);
}

void setup()
{
    vibrate();
    Serial.begin(115200);
#ifndef __AVR__
    analogReadResolution(12);
#endif
}

void loop()
{
    if (!strip_due(&strip, micros()))
        return;
    struct strip_readings readings;
    force(&readings);
    readings.position_sum = position_sum();
    uint32_t sampled_us = micros();
    uint8_t packet[STRIP_PACKET_BYTES];
    uint8_t count = strip_take(&strip, readings, sampled_us, micros(), packet);
    if (count && Serial.availableForWrite() >= count)
        Serial.write(packet, count); /* else the host does not read: the packet is dropped */
}
