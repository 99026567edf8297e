/PROG  CONDITIONS
/ATTR
OWNER		= MNEDITOR;
COMMENT		= "branches";
PROG_SIZE	= 812;
CREATE		= DATE 22-11-03  TIME 14:12:10;
MODIFIED	= DATE 23-01-09  TIME 07:45:56;
FILE_NAME	= ;
VERSION		= 0;
LINE_COUNT	= 15;
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
   1:  SELECT R[1]=1,CALL ONE ;
   2:         =2,JMP LBL[2] ;
   3:         ELSE,JMP LBL[3] ;
   4:  LBL[2:two] ;
   5:L P[1] 100mm/sec FINE     ;
   6:  END ;
   7:  LBL[3:three] ;
   8:  IF (DI[1] AND !DI[2]) THEN ;
   9:L P[2] 100mm/sec FINE     ;
  10:  ELSE ;
  11:J P[3] 50% FINE     ;
  12:  ENDIF ;
  13:  FOR R[5]=1 TO 3 ;
  14:L P[4] 100mm/sec CNT0 ACC80     ;
  15:  ENDFOR ;
/POS
P[1]{
   GP1:
	UF : 1, UT : 1,		<13|gun|fixture>
};
P[2]{
   GP1:
	UF : 1, UT : 1,		<14|gun|fixture>
};
P[3]{
   GP1:
	UF : 1, UT : 1,		<15|gun|fixture>
};
P[4]{
   GP1:
	UF : 1, UT : 1,		<16|gun|fixture>
};
/END
