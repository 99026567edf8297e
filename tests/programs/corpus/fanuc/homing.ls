/PROG  HOMING
/ATTR
OWNER		= MNEDITOR;
COMMENT		= "joints only";
PROG_SIZE	= 812;
CREATE		= DATE 22-11-03  TIME 14:12:10;
MODIFIED	= DATE 23-01-09  TIME 07:45:56;
FILE_NAME	= ;
VERSION		= 0;
LINE_COUNT	= 3;
PROTECT		= READ_WRITE;
TCD:  STACK_SIZE	= 0,
      TASK_PRIORITY	= 50,
      TIME_SLICE	= 0,
      BUSY_LAMP_OFF	= 0,
      ABORT_REQUEST	= 0,
      PAUSE_REQUEST	= 0;
DEFAULT_GROUP	= 1,*,*,*,*;
CONTROL_CODE	= 00000000 00000000;
/MN
   1:J P[1:"HOME"] 25% FINE     ;
   2:J P[2] 25% FINE     ;
   3:J P[9] 25% FINE     ;
/POS
P[1:"HOME"]{
   GP1:
	UF : 0, UT : 1,		
	J1=     0.000 deg,	J2=   -10.000 deg,	J3=    20.000 deg,
	J4=     0.000 deg,	J5=    45.000 deg,	J6=     0.000 deg
};
P[2]{
   GP1:
	UF : 0, UT : 1,		
	J1=    25.500 deg,	J2=   -20.000 deg,	J3=    15.125 deg,
	J4=     5.000 deg,	J5=    60.000 deg,	J6=   -30.000 deg
};
P[9]{
   GP1:
	UF : 0, UT : 1,		
	J1=   -45.000 deg,	J2=    10.000 deg,	J3=    -5.000 deg,
	J4=     0.000 deg,	J5=    35.000 deg,	J6=    90.000 deg
};
/END
